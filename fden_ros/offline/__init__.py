"""Recordings through the pipeline: replay, results, archives, calibration."""
