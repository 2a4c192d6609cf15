"""Procedure ``colours``: the letters' drive values that the camera tells apart best (section III.B)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pattern_gen.charts import colour_chart_drives, intensity_levels
from pattern_gen.projection import FrameRequest, Mode
from sl_calibration.colour_calibration import calibrate_colours, save_colours
from sl_calibration.colour_charts import ChartSamples, colour_chart_samples
from sl_calibration.colour_letters import LetterOptions
from sl_calibration.motion_plan import Coverage, Estimate
from sl_calibration.procedures.procedure import Outcome, Setup, Shot, Source
from sl_calibration.sessions import Sample
from sl_common.errors import InvalidInputError

COLOURS_FILE = "colours.yaml"


@dataclass(frozen=True, kw_only=True)
class ColoursProcedure:
    """Colour calibration: one sample is one run of the chart; several runs are taken together.

    Attributes:
        intensity_chart: Project the intensity chart too: 54 frames more, for responses that are no power law.
        adapt_to_scene: Choose letters for all coloured surfaces of the scene.
        options: What letters may look like.
    """

    intensity_chart: bool = False
    adapt_to_scene: bool = False
    options: LetterOptions = field(default_factory=LetterOptions)

    name = "colours"
    source = Source.IMAGES
    robot = False
    uses_camera = False
    uses_pattern = True
    samples_needed = 1
    writes = (COLOURS_FILE,)

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """All frames of the colour chart, then those of the intensity chart."""
        setup.known_pattern()
        frames = [FrameRequest(mode=Mode.COLOUR_CHART, step=k) for k in range(len(colour_chart_drives()))]
        if self.intensity_chart:
            frames += [
                FrameRequest(mode=Mode.INTENSITY_CHART, channel=channel, step=step)
                for channel in range(3)
                for step in range(len(intensity_levels()))
            ]
        return frames

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Read the charts."""
        images = np.stack(shot.images)
        count = len(colour_chart_drives())
        found = colour_chart_samples(images[:count], images[count:] if self.intensity_chart else None)
        arrays = {
            "drives": found.drives,
            "camera": found.camera,
            "albedos": found.albedos,
            "places": np.array(found.places),
        }
        return Sample(f"chart_{shot.stamp}", shot.stamp, arrays)

    def points(self, sample: Sample) -> int:
        """Number of places that saw the chart."""
        return int(sample.arrays["places"])

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """No robot takes part."""
        return None

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """One sample is enough."""
        text = "no samples yet: light the scene with the projector and call ~/take_sample"
        if samples:
            places = ", ".join(str(self.points(s)) for s in samples)
            text = f"{len(samples)} samples of the chart, at {places} places; enough: call ~/compute"
        return Coverage(float(bool(samples)), float("nan"), float("nan"), text)

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Fit the response and choose the letters."""
        if not samples:
            raise InvalidInputError("no samples: call ~/take_sample while the chart is in view")
        pattern = setup.known_pattern()
        if not pattern.letters:
            raise InvalidInputError("the session's pattern has no letters: begin another session")
        chart = ChartSamples(
            np.concatenate([s.arrays["drives"] for s in samples]),
            np.concatenate([s.arrays["camera"] for s in samples]),
            np.concatenate([s.arrays["albedos"] for s in samples]),
            sum(self.points(s) for s in samples),
        )
        result = calibrate_colours(chart, pattern, self.options, adapt_to_scene=self.adapt_to_scene)
        message = (
            f"{result.samples} patches at {chart.places} places, the response fits to {result.model.rms:.2f} grey"
            f" levels RMS; least distance of two letters {result.least_before:.1f} before, {result.least_after:.1f}"
            " after"
        )
        return Outcome(result, message, {s.name: float("nan") for s in samples}, float("nan"))

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write colours.yaml."""
        path = Path(folder).expanduser().resolve() / COLOURS_FILE
        save_colours(path, outcome.result)
        return [path]
