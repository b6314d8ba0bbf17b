"""Train one recipe: resumable, a CSV row per report interval, curves at the end.

    make train ARGS="compact"    # or: PYTHONPATH=python .venv-train/bin/python training/train.py compact
    make train ARGS="compact --start models/tcae.onnx --recordings city.sigmf-meta harbour.sigmf-meta --name mine"

State lies in ``training/runs/<recipe>/``: ``checkpoint.pt``, ``log.csv``, ``curves.png``. A killed run loses at most
ten minutes: the same command resumes it from the checkpoint.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from queue import Empty

import numpy as np
import onnx
import torch
from configs import CONFIGS, SceneConfig
from data import batches, stored_set, validation_batches
from google.protobuf.message import DecodeError
from losses import BeatLoss, sample_loss
from networks import build
from networks.layers import Tables
from onnx import numpy_helper
from recipes import RECIPES, Recipe
from torch import Tensor, nn

from radalt.core.mitigation.any_sweep import layout_of
from radalt.core.waveform import Waveform

RUNS = Path(__file__).resolve().parent / "runs"
COLUMNS = ("step", "examples", "epoch", "seconds", "rate", "train_loss", "validation_loss")
_WARM_UP = 200  # steps over which the learning rate rises
_SAVE_EVERY_S = 600.0  # time between two checkpoints, at most
_SAY_EVERY_S = 10.0  # time between two lines of progress, the first at the first step


def normalise(planes: Tensor, kind: str) -> Tensor:
    """(B, 2, N) frames normalised as in `radalt.core.mitigation.tcae`."""
    if kind == "joint_rms":
        return planes / torch.sqrt(2 * torch.mean(planes**2, dim=(1, 2), keepdim=True)).clamp(min=1e-30)
    dims = (2,) if kind == "per_channel_peak" else (1, 2)
    return planes / planes.abs().amax(dim=dims, keepdim=True).clamp(min=1e-30)


def _produce(
    queue: multiprocessing.Queue, config: SceneConfig, recipe: Recipe, first: int, share: int
) -> None:
    """Worker: fills its queue with batches without end, one of ``share`` workers that take turns."""
    torch.set_num_threads(1)
    for made in batches(config, recipe.waveform, recipe.batch, first, share):
        queue.put(made)


def _take(queue: multiprocessing.Queue, worker: multiprocessing.Process) -> tuple:
    """The next batch; raises ChildProcessError if the worker has ended, instead of waiting without end."""
    while True:
        try:
            return queue.get(timeout=5.0)
        except Empty:
            if not worker.is_alive():
                raise ChildProcessError(
                    f"the process that makes examples ended with status {worker.exitcode}; the training is kept, "
                    "the same command resumes it"
                ) from None


def exported_weights(model: Path) -> dict[str, Tensor]:
    """Trained weights by parameter name from a file of `export.py`, in float32.

    Raises
    ------
    ValueError
        If the file is no such model.
    """
    if not model.is_file():
        raise ValueError(f"--start {model} does not exist")
    try:
        read = onnx.load(str(model))
    except DecodeError:
        raise ValueError(f"--start {model} is no ONNX file") from None
    names = {entry.key: entry.value for entry in read.metadata_props}.get("radalt_weights", "").split(",")
    stored = {t.name: numpy_helper.to_array(t) for t in read.graph.initializer}
    have = {}
    for name in names:
        if name + ".int8" in stored:
            values = stored[name + ".int8"] * stored[name + ".scale"]
        else:
            values = stored.get(name, stored.get(name + ".float16"))
        if values is None:
            raise ValueError(f"--start {model} does not hold its weights; name one that export.py made")
        have[name.removeprefix("network.")] = torch.tensor(values, dtype=torch.float32)
    return have


def without_blocks(weights: dict[str, Tensor], dropped: Sequence[int]) -> dict[str, Tensor]:
    """Weights of the network without these gated blocks, the others renumbered."""
    kept = {}
    for name, values in weights.items():
        stack, _, rest = name.partition("blocks.")
        if not stack and rest:
            number, _, part = rest.partition(".")
            if int(number) in dropped:
                continue
            name = f"blocks.{int(number) - sum(d < int(number) for d in dropped)}.{part}"
        kept[name] = values
    return kept


class Trainer:
    """State of one run; `run` continues from it."""

    def __init__(
        self,
        name: str,
        recipe: Recipe,
        *,
        device: str,
        interval: int,
        start: Path | None = None,
        runs: Path = RUNS,
        recordings: Sequence[str] = (),
        validation: int = 256,
        keep: Path | None = None,
    ) -> None:
        self.recipe, self.device, self.interval = recipe, torch.device(device), interval
        self.runs, self.folder = runs, runs / name
        self.folder.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(0)
        self.waveform = recipe.waveform
        self.network = build(recipe.network, self.waveform).to(self.device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), recipe.rate, fused=True)
        self.step, self.seconds, self.last = 0, 0.0, recipe.stop or recipe.steps
        self._resume(start)
        self.config = replace(CONFIGS[recipe.data], recordings=tuple(recordings))
        self.stored = stored_set(self.config, self.waveform, keep) if keep and self.config.size else None
        sets = validation_batches(self.config, self.waveform, validation)
        self.validation = [(received, clean, sweep) for received, clean, _, sweep in sets]

    def _resume(self, start: Path | None) -> None:
        """Load the checkpoint, else the weights to start from: an exported model's, or those of the recipe before."""
        weights = None
        path = self.folder / "checkpoint.pt"
        if path.is_file():
            state = torch.load(path, map_location=self.device, weights_only=True)
            self.network.load_state_dict(state["network"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.step, self.seconds = state["step"], state["seconds"]
            self._forget_rows_after(self.step)
        elif start is not None:
            weights = exported_weights(start)
        elif self.recipe.start_from:
            start = self.runs / self.recipe.start_from / "checkpoint.pt"
            weights = torch.load(start, map_location=self.device, weights_only=True)["network"]
        if weights is None:
            return
        weights = without_blocks(weights, self.recipe.dropped_blocks)
        own = {name: values.shape for name, values in self.network.state_dict().items()}
        if own != {name: values.shape for name, values in weights.items()}:
            raise ValueError(f"weights of {start} do not fit the network {self.recipe.network!r}")
        self.network.load_state_dict(weights)

    def _save(self) -> None:
        state = {
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
        }
        new = self.folder / "checkpoint.new"
        with new.open(
            "wb"
        ) as file:  # on disk before it replaces the old one, so that a kill leaves a complete one
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.folder / "checkpoint.pt")

    def _forget_rows_after(self, step: int) -> None:
        """Delete rows written after the checkpoint, whose steps are done again."""
        path = self.folder / "log.csv"
        if path.is_file():
            head, *rows = path.read_text().splitlines(keepends=True)
            kept = [row for row in rows if row.endswith("\n") and int(row.split(",")[0]) <= step]
            path.write_text(head + "".join(kept))

    def rate(self) -> float:
        """Learning rate of the current step."""
        if self.recipe.schedule == "constant":
            return self.recipe.rate
        warm = min(1.0, (self.step + 1) / _WARM_UP)
        done = min(1.0, self.step / self.recipe.steps)
        return self.recipe.rate * warm * max(1e-3, 0.5 * (1 + float(np.cos(np.pi * done))))

    @lru_cache(maxsize=16)  # noqa: B019 - one trainer a process
    def _of(self, sweep: Waveform) -> tuple[tuple[Tables, ...], BeatLoss]:
        """Tables for the network if the sweep is not its own, and the loss."""
        tables = () if sweep == self.waveform else (Tables(sweep, layout_of(sweep)).to(self.device),)
        loss = BeatLoss(sweep, margin=self.recipe.margin, faint=self.recipe.faint, floor=self.recipe.floor)
        return tables, loss.to(self.device)

    def loss(self, received: np.ndarray, clean: np.ndarray, sweep: Waveform) -> Tensor:
        """Loss of a batch of raw frames of a sweep."""
        tables, beat_loss = self._of(sweep)
        x = normalise(torch.from_numpy(received).to(self.device), self.network.normalisation)
        target = torch.from_numpy(clean).to(self.device)
        bfloat16 = self.recipe.bfloat16 and (
            self.device.type != "cpu" or torch.cpu._is_avx512_bf16_supported()
        )
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=bfloat16):
            output = self.network(x, *tables)
        if self.recipe.loss == "beat":
            return beat_loss(output.float(), target)
        return sample_loss(output.float(), normalise(target, self.network.normalisation))

    @torch.no_grad()
    def validate(self) -> float:
        """Mean loss over the validation examples."""
        self.network.eval()
        parts = [float(self.loss(*batch)) for batch in self.validation]
        self.network.train()
        return float(np.mean(parts))

    def train_step(self, received: np.ndarray, clean: np.ndarray, sweep: Waveform) -> float:
        """One optimiser step; a loss that is not finite skips it."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        self.optimiser.zero_grad(set_to_none=True)
        loss = self.loss(received, clean, sweep)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        if torch.isfinite(norm):
            self.optimiser.step()
        self.step += 1
        return float(loss.detach())

    def _makers(self, count: int) -> list[tuple[multiprocessing.Queue, multiprocessing.Process]]:
        """Started workers and their queues, read in turn: the order of batches does not depend on their number."""
        makers = []
        for k in range(count):
            queue: multiprocessing.Queue = multiprocessing.Queue(4)
            first = (self.step + k) * self.recipe.batch
            worker = multiprocessing.Process(
                target=_produce, args=(queue, self.config, self.recipe, first, count), daemon=True
            )
            worker.start()
            makers.append((queue, worker))
        return makers

    def _made(
        self, makers: list[tuple[multiprocessing.Queue, multiprocessing.Process]]
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Waveform]]:
        """Batches from the current step on, from the stored set or from the workers in turn."""
        if self.stored is not None:
            first = self.step * self.recipe.batch
            yield from batches(self.config, self.waveform, self.recipe.batch, first, stored=self.stored)
        for maker in cycle(makers):
            yield _take(*maker)

    def run(self, until: float, workers: int = 1) -> None:
        """Train to the recipe's end or until the wall-clock time ``until`` (seconds since the epoch)."""
        makers = self._makers(workers) if self.stored is None else []
        made = self._made(makers)
        recent: list[float] = []
        begin = mark = saved = time.monotonic()
        first, said = self.step, -np.inf
        try:
            while self.step < self.last and time.time() < until:
                recent.append(self.train_step(*next(made)))
                now = time.monotonic()
                self.seconds += now - mark
                mark = now
                if now - said > _SAY_EVERY_S:
                    self._say((now - begin) / (self.step - first), until - time.time())
                    said = now
                if self.step % self.interval == 0 or self.step == self.last:
                    self._report(float(np.mean(recent)))
                    recent.clear()
                    saved = now
                elif now - saved > _SAVE_EVERY_S:
                    self._save()
                    saved = now
            self._save()
        finally:
            for _, worker in makers:
                worker.terminate()
                worker.join()

    def _say(self, step_s: float, allowed_s: float) -> None:
        """Print progress, on a terminal in a line that the next one overwrites."""
        left_s = min((self.last - self.step) * step_s, max(0.0, allowed_s))
        text = f"[{self.step}/{self.last}] {step_s:.2g} s a step, about {max(1, round(left_s / 60))} min left"
        print(text, end="\r" if sys.stdout.isatty() else "\n", flush=True)

    def _report(self, train_loss: float) -> None:
        size = self.config.size
        examples = self.step * self.recipe.batch
        row = (self.step, examples, f"{examples / size:.3f}" if size else "", f"{self.seconds:.1f}")
        row += (f"{self.rate():.3g}", f"{train_loss:.4f}", f"{self.validate():.4f}")
        path = self.folder / "log.csv"
        fresh = not path.is_file()
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(COLUMNS)
            writer.writerow(row)
        print(dict(zip(COLUMNS, row, strict=True)), flush=True)
        self._save()


def draw_curves(folder: Path) -> None:
    """Training and validation loss over examples, from the CSV."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    with (folder / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    examples = [int(row["examples"]) for row in rows]
    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axis.plot(examples, [float(row["train_loss"]) for row in rows], color="#0072B2", label="training")
    axis.plot(
        examples, [float(row["validation_loss"]) for row in rows], "--", color="#D55E00", label="validation"
    )
    axis.set(xlabel="examples", ylabel="loss", title=folder.name)
    axis.legend()
    axis.grid(alpha=0.3)
    figure.savefig(folder / "curves.png", dpi=110)
    plt.close(figure)


def _missing_before(recipe: Recipe, runs: Path) -> list[str]:
    """Recipes without a checkpoint that have to be trained before this one, in order."""
    names: list[str] = []
    while recipe.start_from in RECIPES and not (runs / recipe.start_from / "checkpoint.pt").is_file():
        names.insert(0, recipe.start_from)
        recipe = RECIPES[recipe.start_from]
    return names


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipe", nargs="?", default="compact", choices=sorted(RECIPES))
    parser.add_argument("--name", help="folder below training/runs (default: the recipe's name)")
    parser.add_argument("--start", type=Path, metavar="FILE", help="exported model to start from")
    parser.add_argument(
        "--recordings", nargs="+", default=[], metavar="FILE", help="SigMF files to train against"
    )
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of all runs (default: training/runs)")
    parser.add_argument("--batch", type=int, help="examples per step instead of the recipe's")
    parser.add_argument("--validation", type=int, default=256, help="validation examples")
    parser.add_argument("--steps", type=int, help="instead of the recipe's number")
    parser.add_argument("--minutes", type=float, default=1e6, help="stop, resumable, after this long")
    parser.add_argument("--interval", type=int, default=250, help="steps between reports")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="make a finite data set once and keep it there (3.6 GB)"
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--workers", type=int, default=1, help="processes that make examples")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    args = parser.parse_args()
    if args.workers < 1:
        parser.error(f"--workers is {args.workers}; at least one process has to make examples")
    recipe = RECIPES[args.recipe]
    if args.steps:
        recipe = replace(recipe, steps=args.steps, stop=0)
    if args.batch:
        recipe = replace(recipe, batch=args.batch)
    torch.set_num_threads(args.threads)
    where = {
        "device": args.device,
        "interval": args.interval,
        "runs": args.runs,
        "validation": args.validation,
        "keep": args.keep,
    }
    for name in [] if args.start else _missing_before(recipe, args.runs):
        print(f"{args.recipe} starts from {name}: training that first", flush=True)
        earlier = Trainer(name, RECIPES[name], **where)
        earlier.run(time.time() + 60 * args.minutes, args.workers)
        draw_curves(earlier.folder)
    examples = f"{recipe.stop or recipe.steps} steps of {recipe.batch} examples on {args.device}"
    print(
        f"{args.name or args.recipe}: {examples}; first {args.validation} examples to validate with",
        flush=True,
    )
    try:
        trainer = Trainer(
            args.name or args.recipe, recipe, start=args.start, recordings=args.recordings, **where
        )
    except ValueError as error:
        parser.error(str(error))
    if trainer.step:
        fresh = f", not from {args.start}" if args.start else ""
        print(f"resumes from its own checkpoint at step {trainer.step}{fresh}", flush=True)
    elif args.start:
        print(f"starts from the weights of {args.start}, with a new step count and optimiser", flush=True)
    try:
        trainer.run(time.time() + 60 * args.minutes, args.workers)
    except ChildProcessError as error:
        parser.error(str(error))
    if (trainer.folder / "log.csv").is_file():
        draw_curves(trainer.folder)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:  # in any of the recipes that a run begins with
        print("\ntrain.py: stopped; the same command resumes from the last report", file=sys.stderr)
        sys.exit(130)
