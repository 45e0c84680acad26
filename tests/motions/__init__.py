"""Motions that the contract can say: each is one file and one YAML."""
