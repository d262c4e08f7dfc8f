"""Online identification of soft tissue with the FDEN model (fractional dynamics, exponential nonlinearity)."""

__version__ = "0.1.0"
