"""Whatever goes wrong with a Falcon, in whatever state: no force, a sentence, the others go on, and it comes back."""

import os

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

import hapjax
from falcon_cases import HARMLESS, HIDDEN, Loop, Rig, is_a_sentence, random_run
from hapjax_devices import DeviceError, ForceSensor, VirtualDevice, run
from hapjax_devices.falcon.emulator import Fault
from hapjax_devices.falcon.processor import synthetic_firmware

NO_ANSWER = "its boot loader does not answer: switch it off and on again"
# What is said where the way to a running Falcon leads through a fault; `None`: it gets there all the same.
ON_THE_WAY = {
    Fault.SHORT_PACKETS: None,
    Fault.GARBAGE: NO_ANSWER,
    Fault.SILENCE: NO_ANSWER,
    Fault.TIMEOUT: NO_ANSWER,
    Fault.DEAF: "nothing came over USB in time",
    Fault.UNPLUG: "no Falcon is attached, or it has no power",
    Fault.WRONG_ECHO: "did not take its firmware: 10 times its boot loader echoed something else",
    Fault.HOMING_LOST: "is not homed: pull its grip all the way out, then push it all the way in",
    Fault.CORRUPT: "which no position of its grip has",
    Fault.POWER: NO_ANSWER,
    Fault.FORBIDDEN: "may not be opened by this user",
    Fault.BUSY: "is in use by another program",
}
# What is said first where the fault comes in a state, if it is another thing.
FIRST = {
    "homing": dict.fromkeys(
        (Fault.GARBAGE, Fault.SILENCE, Fault.TIMEOUT, Fault.POWER), "no packet came for 100 ms"
    )
    | {Fault.UNPLUG: "is not attached any more"}
    | dict.fromkeys((Fault.WRONG_ECHO, Fault.DEAF, Fault.FORBIDDEN, Fault.BUSY)),
    "running": dict.fromkeys(
        (Fault.GARBAGE, Fault.SILENCE, Fault.CORRUPT, Fault.POWER),
        "no packet that makes sense came in two ticks",
    )
    | {Fault.TIMEOUT: "nothing came over USB in time", Fault.UNPLUG: "is not attached any more"}
    | {Fault.HOMING_LOST: "has lost its homing"}
    | dict.fromkeys(HARMLESS),
}
for state in ("booting", "uploading"):
    FIRST[state] = {Fault.UNPLUG: "is not attached any more"} | dict.fromkeys((Fault.FORBIDDEN, Fault.BUSY))
FIRST["connecting"] = {}


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    file = tmp_path_factory.mktemp("firmware") / "falcon.bin"
    file.write_bytes(synthetic_firmware(500))
    return file


@pytest.mark.parametrize("fault", Fault)
def test_opening_with_a_fault(fault, firmware):
    """From closed: a sentence within seconds and nothing left open, or it opens; mended, it opens."""
    rig = Rig(runs=False, firmware=firmware)
    rig.emulated.inject(fault)
    said = ON_THE_WAY[fault]
    if said is None:
        rig.falcon.open()
    else:
        with pytest.raises(DeviceError, match=said) as error:
            rig.falcon.open()
        assert rig.clock.time < 15e9 and is_a_sentence(str(error.value))
        assert rig.falcon.state == "closed" and rig.falcon.fault == str(error.value) and not rig.pushes()
    rig.emulated.mend()
    rig.falcon.open()
    rig.tick()
    assert rig.pushes() and rig.falcon.fault is None


@pytest.mark.parametrize("state", FIRST)
@pytest.mark.parametrize("fault", Fault)
def test_a_fault_in_a_loop(fault, state, firmware):
    """In every state: no force within two ticks, what is said, another device that goes on, and the way back."""
    rig = Rig(firmware=firmware)
    rig.falcon.open()
    loop = Loop(rig)
    loop.tick()
    if state != "running":  # on the way back from a loss of power
        rig.emulated.inject(Fault.POWER)
        loop.until(lambda: rig.falcon.state == "faulted")
        rig.emulated.mend()
        rig.emulated.processor.homes_after = None
        loop.until(lambda: rig.falcon.state == state)
    first = FIRST[state].get(fault, ON_THE_WAY[fault])
    rig.emulated.inject(fault)
    for _ in range(HIDDEN):
        loop.tick()
    if first is None or fault is Fault.CORRUPT:
        rig.emulated.processor.homes_after = 0.02
    if first is None and state == "running":
        for _ in range(20):
            loop.tick()
            assert rig.falcon.state == "running" and rig.pushes()
        assert not loop.fingers.faults
    elif first is None:
        loop.until(lambda: rig.falcon.state == "running")
    elif fault is Fault.HOMING_LOST and state != "running":  # no error: it waits for its user
        loop.until(lambda: rig.falcon.state == "homing")
        for _ in range(20):
            loop.tick()
            assert rig.falcon.state == "homing"
        told = [event.sentence for event in loop.diary.events if first in event.sentence]
        assert told == [rig.falcon.fault] and rig.said == []  # once, by the loop alone
    else:
        told = []
        loop.until(lambda: told.append(rig.falcon.fault or "") or first in told[-1])
        assert is_a_sentence(told[-1])
        loop.tick()
        assert not rig.pushes() or state == "running"
        for _ in range(5):
            loop.tick()
            assert not rig.pushes()
    rig.emulated.mend()
    rig.emulated.processor.homes_after = 0.02
    loop.until_it_pushes()
    assert rig.falcon.fault is None and all(f.back is not None for f in loop.fingers.faults)


RUNS = int(os.environ.get("FALCON_RUNS", "10"))


def test_random_faults(firmware):
    """More of them: `FALCON_RUNS=10000 pytest ...`, or faster `python tests/falcon_cases.py 10000`."""
    came = set().union(*(random_run(seed, firmware) for seed in range(RUNS)))
    assert len(came) >= min(RUNS, 60)


class FalconMachine(RuleBasedStateMachine):
    """A Falcon, its user who opens and closes it, and the world that breaks and mends it, in any order."""

    firmware = None

    def __init__(self):
        super().__init__()
        self.rig = Rig(runs=False, firmware=FalconMachine.firmware)

    @rule()
    def open(self):
        try:
            self.rig.falcon.open()
            assert self.rig.falcon.state == "running"
        except DeviceError as error:
            assert self.rig.emulated.faults and is_a_sentence(str(error))

    @rule()
    def close(self):
        self.rig.falcon.close()

    @precondition(lambda self: self.rig.falcon.state == "running")
    @rule(ticks=st.integers(1, 5))
    def push(self, ticks):
        try:
            for _ in range(ticks):
                self.rig.tick()
            assert self.rig.pushes()
        except DeviceError as error:
            assert is_a_sentence(str(error)) and self.rig.falcon.fault == str(error)

    @precondition(lambda self: self.rig.falcon.state not in ("closed", "running"))
    @rule(steps=st.integers(1, 40))
    def come_back(self, steps):
        for _ in range(steps):
            self.rig.clock.time += 10_000_000
            if self.rig.falcon.recover():
                break

    @rule(fault=st.sampled_from(Fault))
    def breaks(self, fault):
        self.rig.emulated.inject(fault)

    @rule()
    def mend(self):
        self.rig.emulated.mend()

    @invariant()
    def only_a_running_falcon_pushes(self):
        falcon = self.rig.falcon
        assert falcon.state == "running" or not (self.rig.pushes() or falcon.output.any())
        assert falcon.state != "faulted" or is_a_sentence(falcon.fault)

    def teardown(self):
        self.rig.emulated.mend()
        self.rig.falcon.open()
        self.rig.tick()
        assert self.rig.pushes()


def test_any_order_of_faults_and_calls(firmware):
    FalconMachine.firmware = firmware
    run_state_machine_as_test(FalconMachine, settings=settings(max_examples=10, stateful_step_count=15))


class Metronome(VirtualDevice):
    """A device that moves the clock by 2 ms with each write, pulls a Falcon's cable at one tick, and puts it back later."""

    def __init__(self, rig, out, back):
        super().__init__(np.array([[0.05, 0.0, -0.005]]), period=2e-3)
        self.rig, self.ticks = rig, {out: lambda: rig.emulated.inject(Fault.UNPLUG), back: rig.emulated.mend}
        self.written = 0

    def write(self, force):
        self.rig.clock.time += 2_000_000
        self.ticks.get(self.written, int)()
        self.written += 1
        return super().write(force)


@pytest.mark.slow
def test_in_a_servo_loop_the_others_go_on():
    """Through `run`: fingers press on a floor, one through a Falcon that is unplugged for a while."""
    floor = hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.5))
    rig = Rig()
    rig.emulated.processor.place = np.array([0.0, -0.0025, 0.125])  # 2.5 mm below the middle: 2 N
    devices = [rig.falcon, Metronome(rig, out=310, back=350)]
    scene = hapjax.Scene({"floor": floor})
    result = run(scene, devices, 1.5, 500.0, force_sensor=ForceSensor(500.0, 0.0), realtime=False)
    (fault,) = result.faults
    assert (fault.tick, fault.finger) == (311, 0) and "is not attached any more" in fault.sentence
    assert fault.back is not None and 350 < fault.back < 490  # looked for again every 0.2 s
    force, hip = result.recording.force, result.recording.hip
    assert force is not None and hip is not None
    up = force[:, 0, 2]
    np.testing.assert_allclose(
        up[:250], np.linspace(0.0, 2.0, 250), atol=0.05
    )  # it is let in, as later again
    np.testing.assert_allclose(up[250:311], 2.0, atol=0.05)
    assert not force[311 : fault.back + 1, 0].any()
    np.testing.assert_allclose(up[fault.back : fault.back + 250], np.linspace(0.0, 2.0, 250), atol=0.05)
    np.testing.assert_allclose(up[fault.back + 250 :], 2.0, atol=0.05)
    assert np.ptp(hip[311 : fault.back, 0], axis=0).max() == 0  # the finger stays where it was
    assert np.all(force[250:, 1, 2] > 0.5)
