"""Particle filter: beliefs of any shape, as weighted states."""

from __future__ import annotations

from ahnn_plugins.particle.particle_filter import ParticleFilter

__all__ = ["ParticleFilter"]
