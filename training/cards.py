"""Write the model cards from the files' own metadata and the stored rows of the bench.

    PYTHONPATH=python .venv/bin/python training/cards.py          # after new rows in bench/rows
    PYTHONPATH=python .venv/bin/python training/cards.py --time   # times the networks, on an idle machine

Without ``--time`` a card keeps its time.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from radalt.bench.board import stored_rows
from radalt.bench.paired import curves, held
from radalt.bench.rows import read_rows
from radalt.core.mitigation import create
from radalt.core.mitigation.tcae import ANY
from radalt.core.waveform import Waveform
from radalt.evaluation.engine import options
from radalt.evaluation.results.break_point import break_point_of
from radalt.evaluation.results.proportion import clopper_pearson_bound
from radalt.evaluation.results.score import pool
from radalt.evaluation.results.table import metres, table

ROOT = Path(__file__).resolve().parent.parent
STEMS = ("tcae", "any_sweep", "paper", "cnn", "fc")
TITLE = {
    "tcae": "`compact`, the default network of the method `tcae`",
    "any_sweep": "`any_sweep`, what the method `tcae` runs at every sweep but the one of `tcae.onnx`",
    "paper": "`paper`, the temporal convolutional autoencoder of Thornton et al., parameter for parameter",
    "cnn": "`cnn`, the convolution-only autoencoder of Brown et al., with batch normalisation",
    "fc": "`fc`, a fully connected autoencoder for comparison; its layout is ours, as none is published",
}
RECIPE = {
    "tcae": (
        "Loss: log of the beat spectrum's error share after the best complex scale (`training/losses.py`). Adam, "
        "gradient norm limited to 1. Seven parts, each from the weights of the one before: `compact_first` (data "
        "`fresh`, SIR -50..5 dB, peak rate 2e-3, stopped after 2,750 steps of 32 = 88,000 examples), `compact_deep` "
        "(data `deep`, SIR -62..2 dB, peak rate 1.5e-3, cosine to zero, 160,000 examples), `compact_received` (data "
        "`received`: half of the interferers through a fractional delay and a carrier offset, a quarter of the frames "
        "with three at once, 6 % through a converter of 1 to 8 bits; peak rate 1e-3, cosine to zero, 168,000), these "
        "with a wider network (`compact_wide`: seven gated blocks, a gain every 5 cells of the spectrum); then "
        "`compact_lean` (two blocks gone, a gain every 15 cells; new examples of the same kind, same rate, 288,000), "
        "`compact_crowded` (data `crowded`: more NR of 10 MHz, more frames with three at once, 192,000), "
        "`compact_ground` (data `ground`: SNR up to 45 dB, more extended ground, more frames without interference, "
        "144,000) and `compact` (data `noisy`: a quarter of the interferers with white noise of their own 3 to 20 dB "
        "below them, 15 % as received; batches of 64; minus the log of the coherence with the return, "
        "where that is above 0.02, is added to the loss). The examples above count the last part alone. The weight of"
        " samples off the mean modulus was added before the third part. float32 on a shared two-core machine, four "
        "hours in all."
    ),
    "any_sweep": (
        "From the weights of `compact_ground` on, the sixth part of `tcae.onnx`. Every batch of 32 has a sweep of its"
        " own: three in ten that of `tcae.onnx`, the others 1 to 56 MHz in 0.2 to 10 ms, centred or not, 600 to "
        "20,000 samples. A fifth of the frames has no return, and the noise as target; 8 % have two; other radars are"
        " among the interferers; four interferers of ten come as received. Peak rate 1e-3, cosine to "
        "zero; the validation loss fell from -2.49 (after 100 steps) to -2.83 nepers (`training/logs/any_sweep.csv`)."
        " 52 minutes of one to two shared cores."
    ),
    "paper": (
        "The paper's recipe: its set (50,000 + 10,000 examples, I and Q each at unit peak), mean squared error, Adam "
        "at 1e-3, batches of 128, from random weights, the forward pass in bfloat16. Training ran for {epochs:.2f} "
        "epochs, not 150: 4.1 hours of one to two shared cores without a GPU (from 4.6 epochs on with a new "
        "optimiser, from weights of 8 bits). MSE over the validation set fell to 0.114 (0.5 is nothing learned) and "
        "stayed there from 15 epochs on. Dense layers are linear; the "
        "paper does not give the probability of dropout, 0.02 here. Weights are stored as int8 with one scale a row "
        "and widened when the file is loaded; the arithmetic is float32."
    ),
    "cnn": (
        "The layers of arXiv:2410.03423 (`training/networks/cnn.py` states our choices) with batch normalisation after "
        "the inner convolutions, without which they stay on the plateau at this rate (docs/tcae.md). The paper's "
        "recipe and data, as `paper`. {epochs:.2f} epochs of 150 in 2.3 hours of one to two shared cores without a "
        "GPU; MSE over the validation set fell to 0.324 (training error 0.326) and was still falling. Weights are "
        "stored as int8 with one scale a row and widened when the file is loaded."
    ),
    "fc": (
        "The paper's recipe and data, as `paper`. {epochs:.2f} epochs of 150 in 0.8 hours of one to two shared cores "
        "without a GPU (from 6.9 epochs on with a new optimiser, from weights of 8 bits); MSE over the validation set "
        "was least, 0.331, after 3.3 epochs and 0.385 in the end, with 0.177 over the training set: it "
        "overfits. Weights are stored as int8 with one scale a row and widened when the file is loaded."
    ),
}
LIMITS = {
    "tcae": (
        "Frames of 7500 samples aligned with a centred 7.5 MHz sweep at 7.5 MS/s, returns at 0-1500 m and up to "
        "50 m/s; outside that span the output is not the return. 10 MHz NR at full overlap fills the band "
        "evenly and has no constant envelope: there it is as good as no mitigation. The modulus stage lives "
        "from an interferer of constant envelope; a fractional sample delay, a channel or another interferer on top "
        "spoil that, and the break-point then moves up to that of the other stages (row "
        "`qpsk_received`). Only the beat band is put out: what lies outside is removed, interference or not."
    ),
    "any_sweep": (
        "Sweeps of 1 to 56 MHz, 0.2 to 10 ms and 2 to 56 MS/s, frames aligned with the sweep, returns at 0-1500 m. "
        "Without the shift check it makes altitudes of interference alone at narrow sweeps; what the checks leave of "
        "that stands in the table. At 7.5 MHz `tcae.onnx` is used, with much the same break-points. Otherwise as "
        "that."
    ),
    "paper": (
        "Same frames. Trained on rectangular QPSK and tones at SIR -20..0 dB: it gains 4 to 18 dB on rectangular QPSK "
        "and on short bursts, and loses up to 5 dB against no mitigation on what fills the frame. Needs several times "
        "a frame's duration per frame on one core."
    ),
    "cnn": (
        "Same frames. A row for the comparison, not for use: it finds the altitude, and errs more than no mitigation "
        "at every level measured, in 0.2 s of one core a frame."
    ),
    "fc": (
        "Same frames. A row for the comparison, not for use: it finds the altitude of a clean return in 0.93 to 0.97 "
        "of the frames, and declares wrong ones under any interference."
    ),
}


def milliseconds(path: Path) -> float:
    """Tenth percentile of 300 frames of the default sweep on one thread, the method around the network included."""
    method = create("tcae", Waveform(), model=path, shift_check=False, skip_white=False)
    frame = (
        np.random.default_rng(0).standard_normal((1, 7500, 2)).astype(np.float32).view(np.complex64)[..., 0]
    )
    times = []
    for _ in range(300):
        start = time.perf_counter()
        method.process(frame)
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.percentile(times, 10))


def metadata(path: Path) -> dict[str, str]:
    """Metadata of a model file."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return dict(session.get_modelmeta().custom_metadata_map)


def standard_results() -> str:
    """Break-points at full overlap and wrong altitudes of the default network, from the stored rows."""
    lines = []
    for (case, overlap), by in curves(read_rows(stored_rows("standard"))).items():
        if overlap < 1.0:
            continue
        scores = pool(by["tcae"])
        wrong = f"{scores.wrong / scores.trials:.4f} ({scores.wrong_bound:.3f})"
        breaks = (str(break_point_of(by[name])) for name in ("none", "tcae"))
        lines.append([case, *breaks, f"{held(by['none']):.1f}", f"{held(by['tcae']):.1f}", wrong])
    head = ["interferer, full overlap", "break-point of none / dB", "of this", "held by none / dB", "by this"]
    return (
        "Point returns at SNR 10 dB, 7.5 MHz in 1 ms, emitters with half-limit EVM, frames that nothing was\n"
        "developed on: `radalt bench standard --methods none,tcae` (rows in `bench/rows`). Wrong and valid: share of\n"
        "frames declared and 5 m off or more, over all SIRs measured.\n\n"
        + table([*head, "wrong and valid (95 % bound)"], lines)
    )


def paper_results(rows: list[dict[str, Any]], method: str) -> str:
    """Results of one of the paper's networks without interference, under QPSK and tones, with those of none."""
    shown = {
        ("clean clean", 0.0): "none",
        ("sinr qpsk_rectangular", 0.0): "rectangular QPSK, full overlap, SINR 0 dB",
        ("sinr qpsk_rectangular", -15.0): "rectangular QPSK, full overlap, SINR -15 dB",
        ("sir tones", -20.0): "tones, full overlap, SIR -20 dB",
    }
    lines = []
    for case, label in shown.items():
        whole = [r for r in rows if (r["interferer"], r["level_db"]) == case and r["overlap"] in (0.0, 1.0)]
        none, mine = (next(r for r in whole if r["method"] == name) for name in ("none", method))
        cells = [f"{r['pd']:.2f} / {metres(r['rmse_forced_m'])}" for r in (none, mine)]
        lines.append([label, *cells, f"{mine['detections'] - mine['correct']:g} of {mine['trials']:g}"])
    head = ["interference", "none: Pd / RMSE forced / m", "this", "wrong and valid"]
    measured = "`radalt bench paper`, rows in `bench/rows`"
    return f"Point returns at SNR 10 dB, ideal emitters; {measured}.\n\n{table(head, lines)}"


def paper_rows() -> list[dict[str, Any]]:
    """Stored rows of the list `paper` with the keys of the published ones: part, level on its axis, network."""
    parts = {"clean": "clean clean", "qpsk_sinr": "sinr qpsk_rectangular", "tones": "sir tones"}
    out = []
    for row in (row for row in read_rows(stored_rows("paper")) if row["case"] in parts):
        level_db, clean = row["sir_db"], row["sir_db"] is None
        if row["case"] == "qpsk_sinr":
            level_db = -10.0 * np.log10(10.0 ** (-level_db / 10.0) + 10.0 ** (-row["snr_db"] / 10.0))
        where = {"interferer": parts[row["case"]], "level_db": 0.0 if clean else round(level_db, 3) + 0.0}
        out.append(row | where | {"method": row["entry"].removeprefix("tcae_")})
    return out


def other_sweeps() -> str:
    """Altitudes declared without a return, at a sweep of 3 MHz in 2 ms."""
    rows, lines = read_rows(stored_rows("sweeps")), []
    for case, what in (("3M_noise", "noise alone"), ("3M_nr5_alone", "interference alone")):
        mine = {row["entry"]: (row["detections"], row["trials"]) for row in rows if row["case"] == case}
        lines.append(
            [what, *(f"{n} of {of} ({clopper_pearson_bound(n, of):.3f})" for n, of in mine.values())]
        )
    return (
        "Point returns at SNR 10 dB, held-out seeds: `radalt bench sweeps` (rows in `bench/rows`).\n"
        "Altitudes declared without a return, with their 95 % bound, at 3 MHz in 2 ms (more: `docs/sweeps.md`):\n\n"
        f"{table(['frames', *mine], lines)}"
    )


def _sweeps(info: dict[str, str]) -> str:
    """The sweeps that a file serves."""
    if info["radalt_frame_samples"] == ANY:
        return "any sweep in range, its tables as further inputs"
    return (
        f"{info['radalt_frame_samples']} samples, {float(info['radalt_rate_hz']) / 1e6:g} MS/s, sweep centred: "
        f"{'yes' if info['radalt_centered'] == '1' else 'no'}"
    )


def time_of(text: str) -> str:
    """The time in a card; raises `ValueError` if there is none."""
    found = re.search(r"^- ([\d.]+) ms per frame", text, re.MULTILINE)
    if not found:
        raise ValueError("the card states no time; run cards.py --time")
    return found[1]


def _span(config: dict, key: str) -> str:
    return "{:g}..{:g}".format(*config[key])


def card(stem: str, models: Path, found: str, time_ms: str) -> str:
    """Markdown of one card; ``found`` are its results, ``time_ms`` the time per frame as text."""
    path = models / f"{stem}.onnx"
    info = metadata(path)
    content = path.read_bytes()
    config = json.loads(info["radalt_training_data"])
    examples = int(info["radalt_training_examples"])
    epochs = examples / config["size"] if config["size"] else 0.0
    count = f"{examples:,} examples in {int(info['radalt_training_steps']):,} steps"
    kinds = ", ".join(name for name, _ in config["kinds"])
    return f"""# {TITLE[stem]}

- file `{path.name}`, {len(content):,} bytes, SHA-256 `{hashlib.sha256(content).hexdigest()}`
- {int(info["radalt_parameters"]):,} trainable parameters, {info.get("radalt_precision", "float32")} weights
- {time_ms} ms per frame on one thread (x86-64, ONNX Runtime {onnxruntime.__version__})
- contract: `{info["radalt_layout"]}`, normalisation `{info["radalt_normalisation"]}`, {_sweeps(info)}

## Data

Made on the fly from `python/radalt/core` (`training/data.py`): returns at {_span(config, "altitude_m")} m,
up to {config["max_vertical_speed_m_per_s"]:g} m/s, SNR {_span(config, "snr_db")} dB,
SIR {_span(config, "sir_db")} dB, overlap 0.02..1; {kinds}; multipath in
{100 * config["multipath"]:g} %, extended ground return in {100 * config["extended"]:g} % of the examples.
SHA-256 of the first 1,024 examples: `{info["radalt_training_data_sha256"]}`.

## Recipe

Recipe `{info["radalt_recipe"]}`, {count}{f" ({epochs:.2f} epochs)" if epochs else ""}; source revision
`{info["radalt_git_revision"]}`. {RECIPE[stem].format(epochs=epochs)}

## Results

{found}

## Limits

{LIMITS[stem]}

Trained and measured in simulation only. A research tool: not an avionics component. Not for any use in which an
altitude has consequences.

## Licence

{info["radalt_licence"]}, as the module.
"""


def results_of(stem: str) -> str:
    """Results of a card from stored rows."""
    if stem == "tcae":
        return standard_results()
    if stem == "any_sweep":
        return other_sweeps()
    return paper_results(paper_rows(), stem)


@options.command("cards")
def main(argv: Sequence[str] | None = None) -> int:
    """Write the cards; returns 0, or 2 after one line about an error."""
    parser = options.Parser("cards", __doc__)
    add = parser.add_argument
    add("--models", type=options.path, default=ROOT / "models", help="folder of the networks and their cards")
    add("--time", action="store_true", help="time the networks")
    args = parser.parse_args(argv)
    stems = [stem for stem in STEMS if (args.models / f"{stem}.onnx").is_file()]
    if not stems:
        parser.error(f"--models {args.models} holds none of {', '.join(STEMS)}.onnx; name another folder")
    for stem in stems:
        model, page = args.models / f"{stem}.onnx", args.models / f"{stem}.md"
        anew = args.time or not page.is_file()
        time_ms = f"{milliseconds(model):.2f}" if anew else time_of(page.read_text(encoding="utf-8"))
        text = card(stem, args.models, results_of(stem), time_ms)
        page.write_text(text, encoding="utf-8")
        print(page)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
