"""TCAE block: an ONNX network on frames."""

from ..core.scene import Scene
from ..core.scene.build import method_of
from .mitigation import MitigationBlock


class tcae(MitigationBlock):
    """Temporal convolutional autoencoder, or any network with the same ONNX metadata contract; see `Tcae`.

    Category: [RadAlt]/Mitigation. Ports: ``frames: complex vector of N > frames: complex vector of N``.

    Parameters
    ----------
    scene : Scene
        Waveform for the check of the model's contract, on construction.
    model : str
        ONNX file, or ``ENCODER.onnx+DECODER.onnx``; empty takes the scene's ``method_options.tcae.model``, else the
        shipped default.
    threads : int
        ONNX Runtime's threads; 1 is fastest inside a flowgraph.
    batch : int
        Most frames per run of the network. More frames share the cost of the call but add as many milliseconds of
        latency, and the last bit of a result then depends on the grouping of frames.
    skip_clean : bool
        Frames without detected interference pass without the network (`InterferenceDetector`).
    own_process : bool
        Run the network in a separate process and keep the flowgraph's Python blocks to one core (`OwnProcess`): for
        live flowgraphs on two or more cores; no effect on one.
    Example
    -------
    ``clean = radalt.tcae(scene, model="models/tcae.onnx")``
    """

    def __init__(
        self,
        scene: Scene,
        model: str = "",
        threads: int = 1,
        batch: int = 1,
        skip_clean: bool = False,
        own_process: bool = False,
    ) -> None:
        known = scene.method_options.get("tcae") or {}
        switches = {"model": model, "skip_clean": skip_clean, "own_process": own_process}
        own = {"batch": batch, "threads": known.get("threads", threads)}
        own |= {k: v for k, v in switches.items() if v}
        super().__init__("radalt_tcae", method_of(scene, "tcae", own), batch)
