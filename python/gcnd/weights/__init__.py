"""The shipped weights: a registry, model cards, and one way to load them. safetensors only."""

from gcnd.weights.registry import ModelInfo, list_models, load_cascade, save_cascade, weights_hash

__all__ = ["ModelInfo", "list_models", "load_cascade", "save_cascade", "weights_hash"]
