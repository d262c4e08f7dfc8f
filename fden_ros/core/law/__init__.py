"""The FDEN law: geometry, characteristic, fractional memory, response at nodes."""
