"""Interference: emitters, their placement at exact SIR and overlap, and the stream of a jammer."""

from .emitters.qpsk import QpskEmitter
from .emitters.tones import ToneEmitter
from .placement import Emitter, Interferer, interference_frame, interference_frames
