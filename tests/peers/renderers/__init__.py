"""One file for each renderer, and what they share.

A renderer has a `name`, `versions`, the `equal_samplers` that are timed at equal samples, and all its `samplers`, each
with a `ladder` of settings of growing effort.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Setting:
    """A sampler and how much of it: samples per pixel, or an adaptive sampler's threshold."""

    sampler: str
    amount: float

    @property
    def spp(self):
        """Samples per pixel as a whole number."""
        return int(self.amount)

    def __str__(self):
        return f"{self.sampler} {self.amount:g}"


@dataclass
class Timing:
    """Seconds of a process from its start until the image is written, of the processor in it, and of its render phase."""

    whole: float
    processor: float
    render: float | None


class Renderer:
    """What the renderers share."""

    def open(self, scene, folder):
        """Writes the scene in the renderer's own form into the folder."""
        raise NotImplementedError

    def process(self, scene, setting):
        """Renders the scene to a PNG in a process of its own; returns its timing."""
        raise NotImplementedError

    def image(self, scene, setting, seed=0):
        """Returns the linear radiances of a render."""
        raise NotImplementedError

    def render_seconds(self, scene, setting):
        """Returns the seconds of the render phase, with everything loaded, built and compiled that can be."""
        return self.process(scene, setting).render

    def close(self):
        """Ends what `open` started."""

    def reference(self, scene, spp):
        """Returns a converged image, and the noise left in it as half the difference of its two halves."""
        from peers import error

        sampler = self.reference_sampler
        halves = [self.image(scene, Setting(sampler, spp // 2), seed) for seed in [1, 2]]
        return sum(halves) / 2, error.rmse(*halves) / 2
