"""Synthetic tissue and scenarios, the truth for tests and demonstrations.

Shares no numerics with :mod:`fden_ros.core`.
"""
