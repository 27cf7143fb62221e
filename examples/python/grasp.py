"""A hand that closes, and a judge that has learnt from examples whether it holds something, with scikit-learn."""

import random
from dataclasses import dataclass

import dca

WIDTH, CUP = 0.08, 0.055


@dca.message
@dataclass(slots=True)
class Grip:
    force: dca.Force
    width: dca.Length
    stamp: dca.Time | None = None


@dca.service("Closes, and stops at what is between its fingers.", every="20 ms")
class Hand:
    Out = dca.Out(Grip)
    cup = dca.parameter(bool, default=True)

    def init(self, value):
        self.width, self.random = WIDTH, random.Random(1)

    def main_calc(self, tick):
        self.width = max(self.width - 0.04 * tick.elapsed, CUP if self.cup else 0.0)
        touches = self.width in (CUP, 0.0)
        force = self.random.gauss(12.0 if touches else 0.5, 1.0)
        self.Out.send(Grip(force, self.width, tick.now))


@dca.task("Tells whether the hand holds something.", triggered_by="In", outcomes={"held": None, "empty": None})
class Judge:
    In = dca.In(Grip)

    def init(self, value):
        # The import and the training take longer than a period, so they run in parallel to the loop.
        self.learning, self.votes = dca.offload(learn), []

    def main_calc(self, tick):
        grip = self.In.fresh_within(tick.now, "100 ms")
        if grip is None or not self.learning.done:
            return None
        model = self.learning.result()
        self.votes.append(model.predict([[grip.force, 1000.0 * grip.width]])[0])
        for end in ("held", "empty"):
            if self.votes[-10:].count(end) == 10:
                return dca.outcome(end)


def learn():
    """Returns a model that was trained with generated grasps: force in newton, width in millimetre."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    chance = random.Random(7)
    kinds = {"moving": (0.5, 5.0, 80.0), "held": (12.0, 20.0, 70.0), "empty": (12.0, 0.0, 2.0)}
    grasps = [
        (kind, (chance.gauss(force, 1.5), chance.uniform(low, high)))
        for kind, (force, low, high) in kinds.items()
        for _ in range(200)
    ]
    model = make_pipeline(StandardScaler(), PolynomialFeatures(2), LogisticRegression(max_iter=1000))
    return model.fit([features for _, features in grasps], [kind for kind, _ in grasps])


if __name__ == "__main__":
    dca.run(Hand, Judge)
