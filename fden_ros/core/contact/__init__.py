"""When and where the probe touched."""
