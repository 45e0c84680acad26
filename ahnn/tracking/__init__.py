"""Real tracking of satellites: files, the Earth, light, forces, orbit determination."""
