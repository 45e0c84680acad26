"""All that knows Hydra, YAML paths, exit codes and messages."""
