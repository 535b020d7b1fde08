"""Other heads for the first stage: experts gated by noise and sharpness, and displacements beside the normals.

    python benches/heads.py --steps 500

Trained and tested as the variants of benches/ablations.py, whose recipe is the first line; results are kept with its
own. Nothing of this is in the package.

"experts": four heads in the place of one, mixed at every node by a small network that is told how far normals of the
patch and of the node are from those of the scale space (noise), and the eigenvalues of their second moments on every
scale (sharpness). "one wide head": the same four without a gate, which is what the experts' weights are worth.
"displacement": the network also says how far each face's centroid is from its clean place; not used after training.

After Hyper-MD (CVPR 2024) the first, which gives a network weights by noise and by shape.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ablations import (
    Variant,
    finished,
    kept,
    options_of,
    print_header,
    print_row,
    test_shapes,
    tested,
    training_shapes,
)
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.nn.cascade import Cascade, CascadeConfig, PatchConfig, RefinementConfig
from gcnd.nn.networks import NORMAL, DenseNorm, NetworkConfig, NodeNormalNet
from gcnd.nn.ops import pool_nodes
from gcnd.predict import PatchArrays, make_extractor
from gcnd.train import loop, samples
from gcnd.train.loop import Trainer
from gcnd.train.losses import chord_loss
from gcnd.train.samples import Batch, ChunkConfig, FreshNoise, VertexSource, pick_faces

N_EXPERTS = 4
SCALES = tuple(slice(start, start + 3) for start in (17, 20, 23))
"""Of the features: normals of the scale space."""

N_TOLD = 6 + 3 * (1 + len(SCALES))
"""Numbers that the gate is told of a node."""

DISPLACEMENT_WEIGHT = 1.0
"""Of its error, in roots of the mean face's area, beside the normals' chord."""


@torch.no_grad()
def noise_and_sharpness(features: Tensor) -> Tensor:
    """(P, N, C) features to (P, N, 18): distances to smoothed normals here and in the patch, eigenvalues by scale."""
    normals = [features[..., channels].float() for channels in (NORMAL, *SCALES)]
    here = torch.stack([(normals[0] - smooth).norm(dim=-1) for smooth in normals[1:]], dim=-1)
    moments = torch.stack([n.transpose(1, 2) @ n / n.shape[1] for n in normals], dim=1)
    of_patch = torch.cat([here.mean(dim=1), torch.linalg.eigvalsh(moments).flatten(1)], dim=-1)
    return torch.cat([here, of_patch.unsqueeze(1).expand(-1, here.shape[1], -1)], dim=-1)


class ExpertNet(nn.Module):
    """`NodeNormalNet` with several heads after the head's first layer, mixed by a gate or by nobody."""

    def __init__(self, config: NetworkConfig, gated: bool):
        super().__init__()
        self.base = NodeNormalNet(config)
        first, last = config.head_channels
        del self.base.head, self.base.out
        self.heads = DenseNorm(first, N_EXPERTS * last, config.slope)
        self.out = nn.Linear(N_EXPERTS * last, 3)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        gate = nn.Sequential(DenseNorm(N_TOLD, 32, config.slope), nn.Linear(32, N_EXPERTS))
        self.gate = gate if gated else None

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) features and (P, N, 3) neighbours to (P, N, 3)."""
        base = self.base
        x = base.trunk(features, neighbors)
        h = base.head_node(x) + base.head_patch(pool_nodes(base.pool(x))).unsqueeze(1)
        h = self.heads(F.leaky_relu(base.head_norm(h), base.config.slope))
        if self.gate is not None:
            shares = self.gate(noise_and_sharpness(features)).softmax(dim=-1).to(h.dtype)
            h = (h.unflatten(-1, (N_EXPERTS, -1)) * (N_EXPERTS * shares).unsqueeze(-1)).flatten(-2)
        residual: Tensor = self.out(h).float()
        return features[..., NORMAL].float() + residual


class WithAutocast(nn.Module):
    """A network that BatchNorm cannot be folded into, ready for whatever its linear layers are converted to."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """As the network's."""
        with torch.autocast("cpu", dtype=torch.bfloat16):
            normals: Tensor = self.network(features, neighbors)
        return normals


class DisplacementNet(NodeNormalNet):
    """`NodeNormalNet` that returns normals and displacements, (P, N, 6)."""

    def __init__(self, config: NetworkConfig):
        super().__init__(config)
        self.out = nn.Linear(config.head_channels[-1], 6)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, features: Tensor, neighbors: Tensor) -> Tensor:
        """Maps (P, N, C_in) features and (P, N, 3) neighbours to (P, N, 6)."""
        x = self.trunk(features, neighbors)
        h = self.head_node(x) + self.head_patch(pool_nodes(self.pool(x))).unsqueeze(1)
        both: Tensor = self.out(self.head(F.leaky_relu(self.head_norm(h), self.config.slope))).float()
        return torch.cat([features[..., NORMAL].float() + both[..., :3], both[..., 3:]], dim=-1)

    def without(self) -> NodeNormalNet:
        """The network of the normals alone."""
        twin = NodeNormalNet(self.config)
        twin.load_state_dict({k: v[:3] if k.startswith("out.") else v for k, v in self.state_dict().items()})
        return twin


class DisplacementTrainer(Trainer):
    """Adds the mean distance between predicted and true displacements to the loss of the normals."""

    def loss_of(self, batch: Batch) -> Tensor:
        """Runs the network on a batch and returns both losses' sum."""
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.config.precision == "bfloat16"):
            predicted = self.shared(batch.features, batch.neighbors)
        distance = ((predicted - batch.target)[..., 3:].square().sum(dim=-1) + 1e-8).sqrt()
        moved = (distance * batch.weight).sum() / batch.weight.sum().clamp_min(1e-12)
        normals = chord_loss(predicted[..., :3], batch._replace(target=batch.target[..., :3]))
        return normals + DISPLACEMENT_WEIGHT * moved


def patches_with_displacements(
    source: VertexSource, patch: PatchConfig, count: int, config: ChunkConfig, rng: np.random.Generator
) -> Batch:
    """Stands in for what makes the patches of one mesh; the target is (P, N, 6), normals and displacements."""
    shape, vertices, *_ = source.draw(rng)
    extractor = make_extractor(shape.topology, vertices, patch, int(rng.integers(2**31)))
    patches = PatchArrays(count, patch)
    patches.fill(extractor, np.sort(pick_faces(shape, count, config.balance_ratio, rng)))
    clean = shape.normals[patches.face_ids]
    moved = (shape.vertices - vertices)[shape.faces].mean(axis=1)[patches.face_ids]
    moved = moved * (patch.patch_scale / patches.radii)[:, None, None]
    weight = np.exp(-2 * np.square(patches.features[..., :3]).sum(-1)) * patches.mask
    weight = torch.from_numpy((weight * (np.square(clean).sum(-1) > 0.5)).astype(np.float32))

    def turned(vectors: Any, random: np.random.Generator) -> Batch:
        target = np.einsum("pnr,prc->pnc", vectors, patches.world_from_patch).astype(np.float32)
        features = torch.from_numpy(patches.features.copy())
        neighbors = torch.from_numpy(patches.neighbors)
        return samples.flip_frames(Batch(features, neighbors, torch.from_numpy(target), weight), random)

    displacement = turned(moved, copy.deepcopy(rng)).target
    batch = turned(clean, rng)
    return batch._replace(target=torch.cat([batch.target, displacement], dim=-1))


def measured(
    make_network: Callable[[NetworkConfig], nn.Module],
    trainer_of: type[Trainer],
    patches_of: Callable[..., Batch],
    steps: int,
    folder: Path,
) -> dict[str, float]:
    """Trains a network in the place of the recipe's and tests it."""
    config = Variant().config(steps)
    loop.build_network, samples._patches_of_one_mesh = make_network, patches_of  # type: ignore[assignment]
    network, speed = finished(trainer_of(config, FreshNoise(training_shapes(folder))))
    weights = sum(p.numel() for p in network.parameters())
    cascade = Cascade(CascadeConfig((config.stage,), RefinementConfig(iterations=0)))
    ready = network.without() if isinstance(network, DisplacementNet) else WithAutocast(network)
    cascade.stages = nn.ModuleList([ready]).eval()
    about = {"weights": weights, "patches_per_second": speed}
    return about | tested(cascade, test_shapes(folder))


def main() -> None:
    """Trains what is not there yet and prints a table."""
    options = options_of(__doc__)
    ours = samples._patches_of_one_mesh
    heads = {
        "recipe": (NodeNormalNet, Trainer, ours),
        "experts": (partial(ExpertNet, gated=True), Trainer, ours),
        "one wide head": (partial(ExpertNet, gated=False), Trainer, ours),
        "displacement": (DisplacementNet, DisplacementTrainer, patches_with_displacements),
    }
    print_header("head")
    for name, of in heads.items():
        key = f"{name if name == 'recipe' else f'heads {name}'}, {options.steps} steps"
        row = kept(options.out / "results.json", key, partial(measured, *of, options.steps, options.shapes))
        print_row(name, row)


if __name__ == "__main__":
    main()
