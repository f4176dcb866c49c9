"""The sections of a file of motors for `linkplan size`: each motor's values from its data sheet."""

from typing import Annotated

from msgspec import Meta

from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.keys.section import Section, key, required

_NAME = Meta(min_length=1, max_length=99, extra={"said": "a name of 1 to 99 letters"})
_GEARS = Meta(min_length=1, max_length=100, extra={"said": "a list of 1 to 100 gear ratios"})
_EFFICIENCY = Annotated[float, Meta(gt=0, le=1, extra={"said": "a number above 0, at most 1"})]
_BACK_EFFICIENCY = Annotated[float, Meta(ge=0, le=1, extra={"said": "a number from 0 to 1"})]
_MOTORS = Meta(min_length=1, max_length=1000, extra={"said": "a list of 1 to 1000 tables ([[motor]])"})


class CandidateMotor(Motor, frozen=True, kw_only=True):
    """A motor that may drive an actuator: efforts, speeds and rotor are its own, before its gear."""

    name: Annotated[str, _NAME] = required("the name for tables")
    peak_effort: kinds.Positive = key("the largest effort at any instant", "N.m, N", "its stall effort")
    rms_effort: kinds.Positive = key("the largest rms effort over the motion, which its temperature allows", "N.m, N", "any")
    rated_power_w: kinds.Positive = key(
        "by which the smallest motor is found", "W", "the rms effort times the speed that the torque-speed line has there"
    )
    rotor_inertia: kinds.AtLeastZero = key("of its rotor", "kg m2, kg", "0, with a note")
    gears: Annotated[list[kinds.Positive], _GEARS] = key(
        "the gear ratios to try: motor position over joint position", "1, rad/m", "the model's own"
    )
    leads_m: Annotated[list[kinds.Positive], _GEARS] = key(
        "in place of gears, the leads of ball screws to try: the slide's way in a turn of the motor", "m", "none"
    )

    efficiency: _EFFICIENCY = key(
        "of the gear while the motor drives: the torque behind it over gear times the motor's", "", "1"
    )
    back_efficiency: _BACK_EFFICIENCY = key(
        "of the gear while the load drives: gear times the motor's torque over that behind it; 0 locks itself", "", "1"
    )

    @property
    def rated_power(self) -> float | None:
        """The rated power [W]; None if neither it nor rms effort and torque-speed line are given."""
        if self.rated_power_w is not None or self.line is None or self.rms_effort is None:
            return self.rated_power_w
        stall, no_load = self.line
        return self.rms_effort * no_load * max(0.0, 1.0 - self.rms_effort / stall)


class MotorsFile(Section, frozen=True):
    """A list of motors."""

    motor: Annotated[list[CandidateMotor], _MOTORS] = required("the motors ([[motor]])")
