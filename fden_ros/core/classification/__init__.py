"""From parameters with their covariance to a tissue."""
