"""Options that Hydra finds."""
