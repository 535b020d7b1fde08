"""Weights of one network as the start of a larger one that answers the same: more channels, a wider head."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from gcnd.errors import ConfigError
from gcnd.nn.cascade import OPTIONAL_CHANNELS
from gcnd.nn.networks import build_network

if TYPE_CHECKING:
    from gcnd.nn.cascade import StageConfig

Weights = dict[str, torch.Tensor]

_FIRST = ("trunk.static.0.center.weight", "trunk.static.0.neighbor.weight")
"""What the channels of a patch's features are multiplied by."""


def fits(given: StageConfig, wanted: StageConfig) -> bool:
    """Whether weights of one stage can start another.

    Patches may be of another size and have more of `OPTIONAL_CHANNELS`, and the last hidden layer may be wider, but
    not behind a spatial transformer; all else must be the same.
    """
    patch = replace(
        given.patch,
        patch_scale=wanted.patch.patch_scale,
        n_nodes=wanted.patch.n_nodes,
        **{name: getattr(wanted.patch, name) for name in OPTIONAL_CHANNELS},
    )
    heads = given.network.head_channels, wanted.network.head_channels
    network = replace(given.network, in_channels=wanted.network.in_channels, head_channels=heads[1])
    if patch != wanted.patch or network != wanted.network:
        return False
    if any(getattr(given.patch, name) > getattr(wanted.patch, name) for name in OPTIONAL_CHANNELS):
        return False
    if given.network == wanted.network:
        return True
    same_channels = given.network.in_channels == wanted.network.in_channels
    wider = min(map(len, heads)) > 1 and heads[0][:-1] == heads[1][:-1] and heads[0][-1] < heads[1][-1]
    return (
        not network.architecture.startswith("transformed")
        and (same_channels or bool(network.static_channels))
        and (heads[0] == heads[1] or (wider and network.predicts_nodes))
    )


def grown(state: Weights, given: StageConfig, wanted: StageConfig) -> Weights:
    """Fits weights to a stage that may see more or have a wider last hidden layer.

    Both networks answer the same: the weights of new channels are zero, and so are those by which new hidden nodes
    count. What leads to the new nodes is drawn as in a fresh network, always the same.

    Args:
        state: Weights of a network.
        given: The stage that they were trained for.
        wanted: The stage to fit them to.

    Returns:
        Weights for ``wanted.network``.

    Raises:
        ConfigError: The layouts differ in anything else; see `fits`.

    Example:
        >>> from gcnd.train.recipes import get_recipe
        >>> first, second = (config.stage for config in get_recipe("default").stages)
        >>> weights = build_network(first.network).state_dict()
        >>> grown(weights, first, second).keys() == weights.keys()
        True
    """
    if not fits(given, wanted):
        raise ConfigError(
            "the weights to start from have another layout than the recipe's networks",
            hint="start from weights of the same recipe, or leave out --start-from",
        )
    if given.network == wanted.network:
        return state
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        fresh = build_network(wanted.network).state_dict()
    known = _known_channels(given, wanted)
    out: Weights = {}
    for name, old in state.items():
        new = fresh[name].to(old)
        if name in _FIRST and old.shape != new.shape:
            new = new.zero_()
            new[:, known] = old
        elif name == "out.weight":
            new = new.zero_()
            new[:, : old.shape[1]] = old
        elif old.dim() > 0:
            new[: len(old)] = old
        else:
            new = old
        out[name] = new
    return out


def _known_channels(given: StageConfig, wanted: StageConfig) -> torch.Tensor:
    """Of every channel that is wanted, whether the given weights know it."""
    known = [True] * 8
    for name, n in OPTIONAL_CHANNELS.items():
        known += [getattr(given.patch, name)] * n * getattr(wanted.patch, name)
    return torch.tensor(known)
