"""Samples of two streams in, pairs out: checked, synchronised, the tool's weight taken off."""
