"""Physical systems with known Hamiltonians, the ground truth for data, scores and floors.

Each system consists of one class in its own file and one YAML in conf/system.
"""

from __future__ import annotations

from ahnn.systems.base import FilterNoise, Range, System, Units, uniform
from ahnn.systems.cart_pole import CartPole
from ahnn.systems.chain_pendulum import ChainPendulum
from ahnn.systems.charged_particle import ChargedParticle
from ahnn.systems.driven_pendulum import DrivenPendulum
from ahnn.systems.duffing import Duffing
from ahnn.systems.generalised_coordinates import MassMatrixSystem
from ahnn.systems.henon_heiles import HenonHeiles
from ahnn.systems.kepler import Kepler
from ahnn.systems.mass_spring import MassSpring
from ahnn.systems.molniya import Molniya
from ahnn.systems.molniya_gravity import MolniyaGravity
from ahnn.systems.n_body import NBody
from ahnn.systems.oscillator_chain import FermiPastaChain, OscillatorChain, TodaChain
from ahnn.systems.pendulum import Pendulum
from ahnn.systems.truth import exact_flow

__all__ = [
    "CartPole",
    "ChainPendulum",
    "ChargedParticle",
    "DrivenPendulum",
    "Duffing",
    "FermiPastaChain",
    "FilterNoise",
    "HenonHeiles",
    "Kepler",
    "MassMatrixSystem",
    "MassSpring",
    "Molniya",
    "MolniyaGravity",
    "NBody",
    "OscillatorChain",
    "Pendulum",
    "Range",
    "System",
    "TodaChain",
    "Units",
    "exact_flow",
    "uniform",
]
