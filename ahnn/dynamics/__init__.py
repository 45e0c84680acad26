"""What is learned, as plain modules: networks, input maps, energies, Hamiltonians and their scalings."""
