"""Satellite tracking: data files, Earth rotation, light time, forces, orbit determination."""
