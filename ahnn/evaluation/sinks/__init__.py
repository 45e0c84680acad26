"""Output of figures to files, and of figures and scores to TensorBoard."""
