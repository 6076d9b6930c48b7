"""Images as part of what is observed: which, and the spaces that they lie in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.errors import InputError, suggestion
from craftsim.rendering.image_kinds import PIXELS, ImageKind, check_images

ImageCamera = Literal["front", "overview", "top"]
IMAGE_CAMERAS: Final[tuple[str, ...]] = get_args(ImageCamera)


@dataclass(frozen=True)
class Images:
    """What cameras see, beside what is observed anyway; docs/reference/environments.md explains it. Raises
    InputError for a bad value."""

    camera: ImageCamera = "front"
    """``front``, each car's own in its nose, or one of the world's, of which all cars get the same images."""
    size: tuple[int, int] = (64, 48)
    """Width and height in pixels."""
    kinds: tuple[ImageKind, ...] = ("rgb",)
    """Some of rgb, depth and segmentation, as :func:`craftsim.take_images` takes them."""

    def __post_init__(self) -> None:
        check_images(self.size, self.kinds)
        if self.camera not in IMAGE_CAMERAS:
            raise InputError(
                f"unknown camera '{self.camera}'{suggestion(str(self.camera), IMAGE_CAMERAS)}; "
                f"there are {', '.join(IMAGE_CAMERAS)}"
            )

    def cameras(self, n_cars: int) -> list[str]:
        """Return the names of the cameras of a world with so many cars."""
        return [f"front:{car}" for car in range(n_cars)] if self.camera == "front" else [self.camera]

    def of_car(self, taken: dict[str, NDArray[Any]], car: int) -> dict[str, NDArray[Any]]:
        """Return what a car gets, by kind, of the images of all cameras."""
        return {kind: images[car if self.camera == "front" else 0] for kind, images in taken.items()}

    def of_all(self, taken: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return what one who acts for all cars gets: a leading dimension of one entry a car, if each has its own."""
        return taken if self.camera == "front" else self.of_car(taken, 0)

    def spaces(self, n_cars: int | None = None) -> dict[str, spaces.Space[Any]]:
        """Return the spaces, by kind, of what a car gets, or of what one gets who acts for so many."""
        width, height = self.size
        each = () if n_cars is None or self.camera != "front" else (n_cars,)
        found: dict[str, spaces.Space[Any]] = {}
        for kind in self.kinds:
            pixels = PIXELS[kind]
            shape = (*each, height, width, *pixels.shape)
            found[kind] = spaces.Box(pixels.low, pixels.high, shape, pixels.dtype)
        return found
