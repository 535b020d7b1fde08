"""Weights of one network as the start of a larger one that answers the same: more channels, wider layers."""

from __future__ import annotations

import operator
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from gcnd.errors import ConfigError
from gcnd.nn.cascade import OPTIONAL_CHANNELS
from gcnd.nn.networks import build_network

if TYPE_CHECKING:
    from gcnd.nn.cascade import StageConfig
    from gcnd.nn.networks import NetworkConfig

Weights = dict[str, torch.Tensor]

_FIRST = ("trunk.static.0.center.weight", "trunk.static.0.neighbor.weight")
"""What the channels of a patch's features are multiplied by."""


def fits(given: StageConfig, wanted: StageConfig) -> bool:
    """Whether weights of one stage can start another.

    Patches may be of another size and have more of `OPTIONAL_CHANNELS`. The last graph layer, among whose outputs no
    neighbours are looked for, the layer before pooling and the hidden layers of the head may be wider, in a network
    that answers for every node; behind a spatial transformer nothing may. All else must be the same.
    """
    patch = replace(
        given.patch,
        patch_scale=wanted.patch.patch_scale,
        n_nodes=wanted.patch.n_nodes,
        **{name: getattr(wanted.patch, name) for name in OPTIONAL_CHANNELS},
    )
    if patch != wanted.patch:
        return False
    if any(getattr(given.patch, name) > getattr(wanted.patch, name) for name in OPTIONAL_CHANNELS):
        return False
    if given.network == wanted.network:
        return True
    network = replace(given.network, in_channels=wanted.network.in_channels)
    if network.architecture.startswith("transformed"):
        return False
    if network != given.network and not network.static_channels:
        return False
    return network == wanted.network or _is_wider(network, wanted.network)


def _is_wider(given: NetworkConfig, wanted: NetworkConfig) -> bool:
    """Whether a network for every node is another with no layer narrower, and some of those wider that may be."""
    same = replace(
        given,
        dynamic_channels=(*given.dynamic_channels[:-1], *wanted.dynamic_channels[-1:]),
        pool_channels=wanted.pool_channels,
        head_channels=wanted.head_channels,
    )
    widths = [
        (*network.dynamic_channels, network.pool_channels, *network.head_channels)
        for network in (given, wanted)
    ]
    no_narrower = len(widths[0]) == len(widths[1]) and all(map(operator.le, *widths))
    return wanted.predicts_nodes and same == wanted and no_narrower


def grown(state: Weights, given: StageConfig, wanted: StageConfig) -> Weights:
    """Fits weights to a stage that may see more or have wider layers.

    Both networks answer the same: nothing that there was counts what is new. What leads to new nodes is drawn as in a
    fresh network, always the same.

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
    pooled = torch.arange(wanted.network.pool_channels) < given.network.pool_channels
    known = {"head_patch.weight": pooled.repeat(2)}
    known |= dict.fromkeys(_FIRST, _known_channels(given, wanted))
    return {name: _placed(old, fresh[name].to(old), known.get(name)) for name, old in state.items()}


def _placed(old: torch.Tensor, fresh: torch.Tensor, known: torch.Tensor | None) -> torch.Tensor:
    """Old values in their places among fresh ones.

    Args:
        old: (R, C), (R,) or ().
        fresh: (R', C'), (R',) or (), no smaller.
        known: (C',) of bool, which columns the old ones are; None for the first.

    Returns:
        As ``fresh``; the old rows hold zeros in new columns.
    """
    if old.dim() == 0:
        return old
    if old.dim() == 1:
        fresh[: len(old)] = old
        return fresh
    if known is None:
        known = torch.arange(fresh.shape[1]) < old.shape[1]
    fresh[: len(old)] = 0.0
    fresh[: len(old), known] = old
    return fresh


def _known_channels(given: StageConfig, wanted: StageConfig) -> torch.Tensor:
    """Of every channel that is wanted, whether the given weights know it."""
    known = [True] * 8
    for name, n in OPTIONAL_CHANNELS.items():
        known += [getattr(given.patch, name)] * n * getattr(wanted.patch, name)
    return torch.tensor(known)
