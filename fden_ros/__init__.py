"""Identify soft tissue online with the FDEN model: fractional dynamics, exponential stress."""

__version__ = "0.1.0"
