"""Where the time of a training step goes: making data, forward, backward, optimiser, as a table.

    python benches/training_step.py --preset default --threads 2

Data is made by a thread of its own beside the optimiser, on the same cores; here each part is timed alone, and then the
loop as it runs.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from gcnd.train.corpus import generated_shapes
from gcnd.train.loop import StepReport, Trainer, batches
from gcnd.train.recipes import get_recipe
from gcnd.train.run import adapted
from gcnd.train.samples import FreshNoise

PARTS = ("data", "forward", "backward", "optimiser")
WARM_UP = 3


def main() -> None:
    """Times the parts of a step, and the loop."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--steps", type=int, default=48)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    recipe = adapted(get_recipe(options.preset), device=options.device)
    config = replace(recipe.stages[0], steps=options.steps + WARM_UP)
    source = FreshNoise(generated_shapes(12, recipe.seed, options.shapes))
    trainer = Trainer(config, source, device=options.device)
    spent = split(trainer, options.steps)
    total = sum(spent.values())
    print(
        f"{options.preset}, {config.precision}, {options.threads} threads, batches of {config.batch} patches"
    )
    print("| part | ms a step | share |\n|---|---|---|")
    for part in PARTS:
        print(f"| {part} | {spent[part] * 1000 / options.steps:.1f} | {spent[part] / total:.0%} |")
    alone = options.steps * config.batch / total
    in_loop = looped(Trainer(config, source, device=options.device))
    print(f"{alone:.0f} patches/s one after the other, {in_loop:.0f} in the loop")


def split(trainer: Trainer, steps: int) -> dict[str, float]:
    """Seconds of each part over a number of steps."""
    spent = dict.fromkeys(PARTS, 0.0)
    on_cuda = torch.device(trainer.device).type == "cuda"
    stream = batches(trainer.source, trainer.config, 0)
    made = [next(stream) for _ in range(steps + WARM_UP)]
    stream.close()
    spent["data"] = seconds_of_data(trainer) * steps
    trainer.network.train()
    for number, batch in enumerate(made):
        marks = [time.perf_counter()]

        def mark(marks: list[float] = marks) -> None:
            if on_cuda:
                torch.cuda.synchronize()
            marks.append(time.perf_counter())

        loss = trainer.loss_of(type(batch)(*(t.to(trainer.device) for t in batch)))
        mark()
        trainer.backpropagate(loss)
        mark()
        trainer.move_weights()
        mark()
        if number >= WARM_UP:
            for part, duration in zip(PARTS[1:], np.diff(marks), strict=True):
                spent[part] += float(duration)
    return spent


def seconds_of_data(trainer: Trainer) -> float:
    """Seconds that the patches of one step take to make, the other threads idle."""
    chunks = 3
    per_chunk = trainer.config.chunk.n_patches // trainer.config.batch
    stream = batches(trainer.source, trainer.config, 0)
    started = time.perf_counter()
    for _ in range(chunks * per_chunk):
        next(stream)
    seconds = time.perf_counter() - started
    stream.close()
    return seconds / (chunks * per_chunk)


def looped(trainer: Trainer) -> float:
    """Patches/s of the loop as it runs, data made beside."""
    speeds: list[float] = []

    def keep(report: StepReport) -> None:
        speeds.append(report.patches_per_second)

    trainer.run(keep)
    return speeds[-1]


if __name__ == "__main__":
    main()
