"""Noise, procedural shapes and the patches made from them."""
