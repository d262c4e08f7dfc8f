"""From blocks of stress and compression to parameters with their covariance."""
