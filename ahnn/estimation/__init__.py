"""What every estimator shares: beliefs, covariances, consistency."""
