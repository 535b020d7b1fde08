"""int8 products at run time: E_a of a cascade with them, and how fast they are beside bfloat16.

    python benches/int8.py --preset default

First the products of a folded network, 4,096 rows on one thread as a batch of patches has them: how often as fast as
bfloat16 is each way that torch has to multiply in int8. "product" takes numbers that are int8 already and gives int32;
the other ways take bfloat16 ("dynamic" float32) and give it back, with a scale a call. They alternate and the best
round counts, in time of the processor.

Then E_a of whole cascades whose linear layers all round their weights to eight bits with a scale a channel, and what
goes in with a scale a batch or a row. Rounded numbers are multiplied in float32, which is exact.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from ablations import NOISE_SEED, test_shapes
from torch import Tensor, nn
from torch.nn import functional as F

from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.metrics import normal_error
from gcnd.nn.cascade import Cascade
from gcnd.weights import load_cascade

ROWS, ROUNDS = 4096, 100
LARGEST = 127


def rounded(x: Tensor, by: str) -> tuple[Tensor, Tensor]:
    """Whole numbers from −127 to 127 and their scale, one for every row or one for all."""
    largest = x.abs().amax(dim=-1, keepdim=True) if by == "row" else x.abs().amax()
    scale = largest.clamp_min(1e-12) / LARGEST
    return (x / scale).round(), scale


class Int8Linear(nn.Module):
    """A linear layer whose product is of whole numbers; what goes in is rounded with a scale by row or batch."""

    def __init__(self, layer: nn.Linear, by: str):
        super().__init__()
        self.by = by
        self.bias = layer.bias
        self.weight, scale = rounded(layer.weight, "row")
        self.scale = scale.squeeze(1)

    def forward(self, x: Tensor) -> Tensor:
        """Maps (…, C) to (…, C')."""
        whole, scale = rounded(x, self.by)
        return F.linear(whole, self.weight) * self.scale * scale + self.bias


def in_int8(cascade: Cascade, by: str, ends: bool) -> Cascade:
    """Replaces the linear layers of folded networks, all of them or all but the first and the last."""
    for network in cascade.stages:
        found = [name for name, layer in network.named_modules() if isinstance(layer, nn.Linear)]
        for name in found:
            kept = not ends and (name == "out" or name == "trunk.layers.0.parts")
            if not kept:
                network.set_submodule(name, Int8Linear(network.get_submodule(name), by))
    return cascade


def ways(n_in: int, n_out: int) -> dict[str, Callable[[], object]]:
    """The same product in bfloat16 and in every int8 of torch."""
    x, layer = torch.randn(ROWS, n_in), nn.Linear(n_in, n_out)
    low, low_layer = x.bfloat16(), nn.Linear(n_in, n_out).bfloat16()
    (whole, _), (weight, scales) = rounded(x, "batch"), rounded(layer.weight.detach(), "row")
    narrow, narrow_weight = whole.to(torch.int8), weight.to(torch.int8).t().contiguous().t()
    scales_of_outputs = scales.squeeze(1)
    onednn = torch.ops.onednn
    prepared = onednn.qlinear_prepack(narrow_weight.contiguous(), [ROWS, n_in])
    zeros, bias = torch.zeros(n_out, dtype=torch.int64), layer.bias.detach()

    def product_and_scales() -> Tensor:
        eight, size = rounded(low, "batch")
        product = torch._int_mm(eight.to(torch.int8), narrow_weight.t())
        return product.float().mul_(scales_of_outputs * size).add_(bias).bfloat16()

    def through_onednn() -> Tensor:
        # From −128 on, as the kernel takes bytes without a sign.
        eight, size = rounded(low, "batch")
        return onednn.qlinear_pointwise(
            (eight + 128).to(torch.uint8), float(size), 128, prepared, scales_of_outputs, zeros, bias, 1.0, 0,
            torch.bfloat16, "none", [], "",
        )  # fmt: skip

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch.ao is on its way out.
        dynamic = torch.ao.quantization.quantize_dynamic(nn.Sequential(layer), {nn.Linear}, torch.qint8)
    return {
        "bfloat16": lambda: low_layer(low),
        "float32": lambda: layer(x),
        "product": lambda: torch._int_mm(narrow, narrow_weight.t()),
        "_int_mm": product_and_scales,
        "oneDNN": through_onednn,
        "dynamic": lambda: dynamic(x),
    }


@torch.inference_mode()
def print_speeds(cascade: Cascade) -> None:
    """A line for every size of product, and one for all together."""
    sizes = [
        (layer.in_features, layer.out_features)
        for layer in cascade.stages[0].modules()
        if isinstance(layer, nn.Linear)
    ]
    totals: dict[str, float] = {}
    for size in dict.fromkeys(sizes):
        calls = ways(*size)
        best = dict.fromkeys(calls, float("inf"))
        for _ in range(ROUNDS):
            for name, call in calls.items():
                started = time.thread_time()
                call()
                best[name] = min(best[name], time.thread_time() - started)
        if not totals:
            print("| in | out | " + " | ".join(best) + " |\n" + "|---" * (2 + len(best)) + "|")
        print_speed(f"{size[0]} | {size[1]}", best)
        totals = {name: totals.get(name, 0.0) + s * sizes.count(size) for name, s in best.items()}
    print_speed("all |", totals)


def print_speed(what: str, seconds: dict[str, float]) -> None:
    """One line: how often as fast as bfloat16."""
    print(
        f"| {what} | " + " | ".join(f"{seconds['bfloat16'] / s:.2f}" for s in seconds.values()) + " |",
        flush=True,
    )


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--levels", type=float, nargs="+", default=[0.2])
    options = parser.parse_args()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    print_speeds(load_cascade(options.preset))
    torch.set_num_threads(threads)
    shapes = test_shapes(options.shapes)
    print("| products | " + " | ".join(shape.kind for shape in shapes) + " | mean |")
    print("|---" * (2 + len(shapes)) + "|")
    for name, cascade, precision in (
        ("float32", load_cascade(options.preset), "float32"),
        ("bfloat16", load_cascade(options.preset), "bfloat16"),
        ("int8, scale a batch", in_int8(load_cascade(options.preset), "batch", True), "float32"),
        ("int8, scale a row", in_int8(load_cascade(options.preset), "row", True), "float32"),
        ("int8, scale a row, not the ends", in_int8(load_cascade(options.preset), "row", False), "float32"),
    ):
        means = []
        for shape in shapes:
            errors = []
            for level in options.levels:
                noisy = add_noise(shape.vertices, shape.faces, level=level, seed=NOISE_SEED)
                clean = denoise_arrays(noisy, shape.faces, cascade, precision=precision)
                errors.append(normal_error(clean, shape.vertices, shape.faces))
            means.append(float(np.mean(errors)))
        figures = " | ".join(f"{mean:.3f}" for mean in (*means, float(np.mean(means))))
        print(f"| {name} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
