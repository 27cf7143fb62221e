"""A camera whose images are generated, and a detector that finds the bright spot in them with numpy."""

from dataclasses import dataclass

import dca
import numpy as np

HEIGHT, WIDTH = 480, 640


@dca.message
@dataclass(slots=True)
class Image:
    height: int
    width: int
    pixels: dca.Bytes
    stamp: dca.Time | None = None


@dca.message
@dataclass(slots=True)
class Spot:
    """Where the spot is, in pixels from the upper left, and how bright."""

    x: float
    y: float
    brightness: float
    stamp: dca.Time | None = None


@dca.service("Shows a spot that goes round in front of noise.", every="33 ms")
class Camera:
    Out = dca.Out(Image)

    def init(self, value):
        self.noise = np.random.default_rng(1).integers(0, 60, (HEIGHT, WIDTH), dtype=np.uint8)

    def main_calc(self, tick):
        x = WIDTH / 2 + 200 * np.cos(tick.now)
        y = HEIGHT / 2 + 150 * np.sin(tick.now)
        picture = self.noise.copy()
        rows, columns = slice(int(y) - 8, int(y) + 9), slice(int(x) - 8, int(x) + 9)
        picture[rows, columns] = 250
        # Any buffer is an image.
        self.Out.send(Image(HEIGHT, WIDTH, picture.data, tick.now))


@dca.service("Finds the brightest spot of an image.", every="200 ms", triggered_by="In")
class Detector:
    In = dca.In(Image)
    Out = dca.Out(Spot)

    def main_calc(self, tick):
        image = self.In.fresh()
        if image is None:
            return
        # Without a copy: the array looks at the bytes that have arrived.
        picture = np.frombuffer(image.pixels, np.uint8).reshape(image.height, image.width)
        bright = picture > 200
        if bright.any():
            y, x = (float(places.mean()) for places in np.nonzero(bright))
            self.Out.send(Spot(x, y, float(picture[bright].mean()), image.stamp))


if __name__ == "__main__":
    dca.run(Camera, Detector)
