"""Decodes single-shot structured light: camera images to camera-projector correspondences."""

from __future__ import annotations

from sl_decoder.decoded import Decoded, Inspection, Reason
from sl_decoder.decoder import Decoder, DecoderOptions
from sl_decoder.tracking import Tracker

__all__ = ["Decoded", "Decoder", "DecoderOptions", "Inspection", "Reason", "Tracker"]
