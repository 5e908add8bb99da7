"""The lesson of `pot_lift`: a script shows how both hands lift the pot and set it down."""

from minidual.environments.scripted import record
from minidual.trials.lessons.transport import TransportLesson

POT_LIFT = TransportLesson(
    "pot_lift",
    demonstrator=record,
    settings={
        "steps": 80_000,
        "demonstrations_n": 600,
        "deviation": 0.05,
        "learning_rate": 1.5e-5,
    },
)
