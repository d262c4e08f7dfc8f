"""Subcommands of ``fden``, one module each: ``add_parser`` and ``run``."""
