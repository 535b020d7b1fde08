"""What training minimises."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from gcnd.nn.distributed import mean_over_processes
from gcnd.train.samples import Batch

_CHORD_EPSILON = 1e-4


def chord_loss(predicted: Tensor, batch: Batch) -> Tensor:
    """Mean chord length between predicted and clean normals, weighted towards the patch centre.

    L = Σ w_i ‖n̂_i − n_i‖ / Σ w_i,  n̂ normalised. Not squared: it estimates the median direction and keeps
    edges sharp, where the squared loss estimates the mean and rounds them.

    Args:
        predicted: (P, N, 3), or (P, 3) for the centre alone.
        batch: Target and weights.

    Choice: docs/choices.md#chord-loss.
    """
    target, weight = (
        (batch.target, batch.weight) if predicted.dim() == 3 else (batch.target[:, 0], batch.weight[:, 0])
    )
    difference = F.normalize(predicted, dim=-1) - target
    chord = (difference.square().sum(-1) + _CHORD_EPSILON**2).sqrt()
    return (chord * weight).sum() / mean_over_processes(weight.sum()).clamp_min(1e-12)


def mse_loss(predicted: Tensor, batch: Batch) -> Tensor:
    """Mean squared difference of the centre's predicted and clean normal, the paper's loss.

    Paper: Sec. 5.1. Choice: docs/choices.md#normal-range (no map to 0…1).
    """
    predicted = predicted if predicted.dim() == 2 else predicted[:, 0]
    return F.mse_loss(predicted, batch.target[:, 0])


LOSSES = {"chord": chord_loss, "mse": mse_loss}
