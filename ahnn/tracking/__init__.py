"""Satellites as ground stations track them: files, the Earth, light, forces, orbit determination."""
