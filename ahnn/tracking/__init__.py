"""Tracking of satellites as ground stations measured it: files, the Earth, light, forces, orbit determination."""
