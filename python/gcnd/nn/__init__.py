"""Layers, networks and the cascade: nothing here knows a mesh."""
