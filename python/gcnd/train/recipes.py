"""Recipes: everything that fixes a training run, by name."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from gcnd.errors import ConfigError
from gcnd.nn.cascade import VERTEX_ITERATIONS, PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.networks import PAPER_FIRST, PAPER_NEXT, NetworkConfig
from gcnd.train.loop import TrainConfig
from gcnd.train.samples import ChunkConfig

DEFAULT_NETWORK = NetworkConfig(
    in_channels=30,
    static_channels=(64, 64),
    dynamic_channels=(64, 64, 128),
    pool_channels=192,
    head_channels=(128, 64),
)
"""Ours: most of its products in the graph layers, few in the layers before pooling and in the head."""

FAST_NETWORK = NetworkConfig(
    in_channels=30,
    static_channels=(48,),
    dynamic_channels=(48, 64),
    pool_channels=64,
    head_channels=(64, 32),
)
"""A fifth of the products of ours."""


@dataclass(frozen=True)
class Recipe:
    """A training run from nothing to shipped weights.

    Attributes:
        name: As in ``gcnd train --preset``.
        description: One line for the model card.
        stages: One entry a network; stage i + 1 trains on what the stages before it made.
        warm_start: Whether a stage starts from the weights of the one before, where the layouts agree.
        n_shapes: Procedural shapes.
        pool_size: Meshes denoised by the stages before, for every stage but the first.
        refinement: Of the normals after the last stage.
        seed: Of shapes, data and weights.
        data: What is learned from: vertex noise on the shapes, or simulated scans of them.
        n_scans: Simulated scans.
        vertex_iterations: Of Eq. 6 after every pass.
        keep_detail: Whether detail that was taken away with weak noise comes back.
        flat_passes: Passes of the last stage more on flat meshes; see `gcnd.nn.cascade.CascadeConfig`.
        pull: Of the first positions at the end; see `gcnd.nn.cascade.CascadeConfig`.
        most_stages: Where above the number of ``stages``, more like the last follow, up to so many, while each lowers
            the error of the validation meshes (`gcnd.train.further`).
    """

    name: str
    description: str
    stages: tuple[TrainConfig, ...]
    warm_start: bool = True
    n_shapes: int = 240
    pool_size: int = 150
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    seed: int = field(default=0)
    data: Literal["noise", "scans"] = "noise"
    n_scans: int = 0
    vertex_iterations: int = VERTEX_ITERATIONS
    keep_detail: bool = False
    flat_passes: int = 0
    pull: float | None = None
    most_stages: int = 0


REFINE_WHERE_CONSISTENT = RefinementConfig(iterations=12, sigma_r=0.15, tolerance=3.0, largest_spread=0.03)
"""Twelve iterations, but only where overlapping predictions agree (docs/experiments.md#where-to-refine)."""


REFINE_FLAT = replace(REFINE_WHERE_CONSISTENT, flat_only=True)
"""On other meshes the fit of the vertices does what refinement did, and better (docs/experiments.md#vertex-fit)."""


OUR_PATCH = PatchConfig(scale_space=True, roughness=True)

OUR_LATER_PATCH = replace(OUR_PATCH, first_normals=True)
"""After the first pass, what it took away can only be told by the mesh before it."""


DEFAULT_LATER_NETWORK = replace(
    DEFAULT_NETWORK,
    dynamic_channels=(64, 64, 256),
    pool_channels=256,
    head_channels=(256, 256),
)
"""As `DEFAULT_NETWORK`, but wider where no neighbours are looked for: last graph layer, pooling and head.

Choice: docs/choices.md#node-head.
"""

FAST_LATER_NETWORK = replace(
    FAST_NETWORK, dynamic_channels=(48, 96), pool_channels=96, head_channels=(96, 128)
)
"""As `FAST_NETWORK`, wider in the same places."""


def _later(network: NetworkConfig, coverage: float, early_coverage: float | None = None) -> StageConfig:
    """A second stage, told the normals before the first pass, which runs twice."""
    told = replace(network, in_channels=OUR_LATER_PATCH.n_channels)
    return StageConfig(told, OUR_LATER_PATCH, passes=2, coverage=coverage, early_coverage=early_coverage)


def _default(*steps: int, later: NetworkConfig = DEFAULT_LATER_NETWORK) -> Recipe:
    """Passes before the last are covered more thinly: what one misses, the next still sees."""
    first = StageConfig(DEFAULT_NETWORK, OUR_PATCH, coverage=1.0)
    return Recipe(
        "default",
        "patch network with a normal for every node, two stages, the second run twice",
        (
            TrainConfig(first, steps=steps[0]),
            TrainConfig(_later(later, 2.0, 1.0), steps=steps[1], lr=1e-3, seed=1),
        ),
        pool_size=400,
        refinement=REFINE_FLAT,
        keep_detail=True,
        flat_passes=1,
        pull=PULL,
    )


def _fast(*steps: int) -> Recipe:
    """As default, with a fifth of the products a patch and half the patches."""
    first = StageConfig(FAST_NETWORK, OUR_PATCH, coverage=0.3)
    return Recipe(
        "fast",
        "small patch network with a normal for every node, two stages, the second run twice",
        (
            TrainConfig(first, steps=steps[0]),
            TrainConfig(_later(FAST_LATER_NETWORK, 0.4), steps=steps[1], lr=1e-3, seed=1),
        ),
        pool_size=400,
        refinement=REFINE_FLAT,
        keep_detail=True,
        pull=PULL,
    )


SCAN_PATCH = {"patch_scale": 8.0, "n_nodes": 256, "first_normals": False}
"""As wide as the paper's for scans, since a scanner's noise is as wide as several faces; the normals before the first
pass gain nothing there, nor does a wider head.

Choice: docs/choices.md#scan-patches."""


SCAN_VERTEX_ITERATIONS = 60
"""Noise wider than a face is taken away slowly. Choice: docs/choices.md#scan-vertex-updating."""


PULL, SCAN_PULL = 0.0026, 0.005
"""A scanner's noise is shared by neighbours: there positions say more, and normals less.

Choice: docs/choices.md#vertex-fit."""


def _on_scans(recipe: Recipe, patch: dict[str, Any], **training: Any) -> Recipe:
    """A recipe with other patches, on simulated scans; every draw is from one of a fixed number of pairs."""

    def on_scans(stage: StageConfig) -> StageConfig:
        wide = replace(stage.patch, **patch)
        network = replace(stage.network, in_channels=wide.n_channels)
        return replace(stage, patch=wide, network=network, early_coverage=None)

    chunk = ChunkConfig(n_meshes=8, n_patches=1024)
    stages = tuple(
        replace(config, stage=on_scans(config.stage), chunk=chunk, **training) for config in recipe.stages
    )
    return replace(recipe, stages=stages, data="scans", n_scans=480)


def _scan(*steps: int) -> Recipe:
    """The default's first network in both stages, on simulated scans."""
    return replace(
        _on_scans(_default(*steps, later=DEFAULT_NETWORK), SCAN_PATCH, batch=64, lr=1e-3),
        name="scan",
        description="wide patches, trained on simulated depth-camera frames, fused frames and scanned prints",
        pool_size=160,
        refinement=replace(REFINE_WHERE_CONSISTENT, sigma_r=0.2),
        vertex_iterations=SCAN_VERTEX_ITERATIONS,
        keep_detail=False,
        flat_passes=0,
        pull=SCAN_PULL,
    )


def _paper(steps: int, later_steps: int) -> Recipe:
    patch = PatchConfig(budget="random", vertex_offsets=False)
    shared = {
        "batch": 128,
        "lr": 1e-4,
        "weight_decay": 0.0,
        "warmup": 0,
        "loss": "mse",
        "chunk": ChunkConfig(n_meshes=8, n_patches=1024),
    }
    return Recipe(
        "paper",
        "the paper's two networks, its features, loss and patch size",
        (
            TrainConfig(StageConfig(PAPER_FIRST, patch), steps=steps, **shared),  # type: ignore[arg-type]
            TrainConfig(StageConfig(PAPER_NEXT, patch), steps=later_steps, seed=1, **shared),  # type: ignore[arg-type]
        ),
        warm_start=False,
    )


def _paper_scan(*steps: int) -> Recipe:
    """The paper's networks as it trains them for scanners: k = 8, 256 nodes, m = 12 (paper Sec. 7.5, 6.1)."""
    return replace(
        _on_scans(_paper(*steps), SCAN_PATCH),
        name="paper-scan",
        refinement=RefinementConfig(iterations=12),
        description="the paper's two networks with its patches for scanners, on simulated scans",
    )


RECIPES = {
    "default": _default(38_000, 118_500),
    "fast": _fast(13_500, 38_000),
    "paper": _paper(450_000, 300_000),
    "scan": _scan(12_000, 13_000),
    "paper-scan": _paper_scan(450_000, 300_000),
}
"""By name. The paper's own numbers of steps are 24 and 16 epochs of 2.4 M patches in batches of 128."""


def get_recipe(name: str) -> Recipe:
    """Returns a recipe by name; raises ``ConfigError`` when there is none."""
    if name not in RECIPES:
        raise ConfigError(f"unknown training preset {name!r}, allowed: {', '.join(RECIPES)}")
    return RECIPES[name]
