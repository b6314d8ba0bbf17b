"""What disturbs the receiver: emitters, their placement at exact SIR and overlap, and the stream a jammer sends."""

from .emitters.qpsk import QpskEmitter
from .emitters.tones import ToneEmitter
from .placement import Emitter, Interferer, interference_frame, interference_frames

__all__ = [
    "Emitter",
    "Interferer",
    "QpskEmitter",
    "ToneEmitter",
    "interference_frame",
    "interference_frames",
]
