"""Libraries of tissues: read, written, trained."""
