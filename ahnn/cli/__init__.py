"""Command-line interface: Hydra, YAML paths, exit codes and messages."""
