"""What one camera shows: paired with the joints, predicted to now, and judged."""

from __future__ import annotations

from fvs_controller_node.agreement import Agreement
from fvs_controller_node.relation import LastSecond
from fvs_ros.filter import Image
from fvs_ros.kinds import Kind
from fvs_ros.track import Track


class Eye:
    """One camera, which measures a kind: m numbers that move in d ways."""

    def __init__(self, kind: Kind) -> None:
        self.track = Track(kind)
        self.agreement = Agreement()  #: of the feature with the arm's motion
        self.last_second = LastSecond(kind)  #: for teaching
        self.image_s: float | None = None  #: stamp of its newest image
        self.late_s = 0.0  #: how late its images are stamped, where a chain tells, s
        self._unjudged: list[Image] = []

    def restart(self) -> None:
        """Compare what is seen with the arm's motion from now on."""
        self.agreement.restart()
        self._unjudged.clear()

    def judge(self) -> None:
        """Judge the images that were accepted since the last call."""
        for image in self._unjudged:
            self.agreement.add(image, self.track.filter.noise_m)
        self._unjudged.clear()

    def add(self, images: list[Image], judged: bool) -> None:
        """Take images that were accepted; not to be judged, if what they show may move itself."""
        self._unjudged += images if judged else []
        for image in images:
            self.last_second.add(image.stamp_s, image.z)
