"""A fit over several devices and several processes gives the answer of one."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import BOTH, floor, recorded
from hapjax import save_scene
from hapjax.cli import main
from hapjax_fitting.sharding import each

HAPJAX = str(Path(sys.executable).parent / "hapjax")


def on_devices(count: int) -> dict[str, str]:
    """The environment of a process with so many devices, and threads enough that all are used."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    return os.environ | {"XLA_FLAGS": flags, "NPROC": str(2 * count)}


def of_two(arguments: list[str], of_second: list[str]) -> list[tuple[int, str, str]]:
    """The exit code, stdout and stderr of two processes of one command."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    started = [
        subprocess.Popen(
            [HAPJAX, *own, "--process", str(i), "2", address],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i, own in enumerate((arguments, of_second))
    ]
    try:
        said = [process.communicate(timeout=100) for process in started]
    finally:
        for process in started:
            process.kill()
    return [(process.returncode, *words) for process, words in zip(started, said, strict=True)]


def written(folder: Path, count: int) -> list[str]:
    """The arguments of a fit to so many short recordings."""
    files = [str(folder / f"{i}.npz") for i in range(count)]
    for i, file in enumerate(files):
        recorded(floor(), i, steps=60, length=0.02 if i < 3 else 1e-4).save(file)
    save_scene(floor(0.9, 500.0), folder / "floor.toml")
    return ["fit", *files, "--scene", str(folder / "floor.toml"), "--free", *BOTH, "--starts", "2"]


@pytest.fixture(scope="module")
def by_one(tmp_path_factory):
    """A fit to five recordings, which neither two processes nor three devices share evenly; in two of them nothing slips,
    which is found. Its arguments and figures."""
    folder = tmp_path_factory.mktemp("one")
    arguments = written(folder, 5)
    assert main([*arguments, "--json", str(folder / "fit.json")]) == 0
    return arguments, json.loads((folder / "fit.json").read_text())


def assert_same(figures, of_one):
    assert figures["findings"] == of_one["findings"] and len(figures["findings"]) == 2
    assert figures["loss"] == pytest.approx(of_one["loss"], rel=1e-10)
    for name in BOTH:
        for key in ("estimate", "standard_error", "interval95"):
            shared, single = figures["parameters"][name][key], of_one["parameters"][name][key]
            np.testing.assert_allclose(shared, single, rtol=1e-10)


@pytest.mark.slow
def test_two_processes_give_the_answer_of_one(by_one, tmp_path):
    arguments, of_one = by_one
    again = [*arguments, "--json", str(tmp_path / "two.json")]
    (code, out, err), (code_of_second, *said_by_second) = of_two(again, again)
    assert code == code_of_second == 0, err
    assert "object.floor.surface.mu" in out and "object" not in "".join(said_by_second)
    assert_same(json.loads((tmp_path / "two.json").read_text()), of_one)


@pytest.mark.slow
def test_three_devices_give_the_answer_of_one(by_one, tmp_path):
    arguments, of_one = by_one
    command = [HAPJAX, *arguments, "--json", str(tmp_path / "three.json")]
    done = subprocess.run(command, capture_output=True, text=True, env=on_devices(3))
    assert done.returncode == 0, done.stderr
    assert_same(json.loads((tmp_path / "three.json").read_text()), of_one)


@pytest.mark.slow
def test_what_one_process_refuses_all_refuse(tmp_path):
    arguments = written(tmp_path, 1)
    without = [word.replace("0.npz", "absent.npz") for word in arguments]
    (code, _, err), (code_of_second, *said_by_second) = of_two(arguments, without)
    assert code == code_of_second == 2
    (line,) = [line for line in err.splitlines() if line.startswith("hapjax: ")]
    assert line.startswith("hapjax: process 1: ") and "absent.npz" in line
    assert "absent" not in "".join(said_by_second)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--distributed", "--process", "0", "2", "localhost:1234"], "one of the two"),
        (["--process", "2", "2", "localhost:1234"], "process is 2 of 2; allowed: 0 to 1"),
        (["--process", "0", "2", "localhost"], "the address 'localhost'; allowed: HOST:PORT"),
    ],
)
def test_processes_that_cannot_be(options, message, tmp_path, capsys):
    assert main([*written(tmp_path, 1), *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_there_must_be_a_job(tmp_path):
    command = [HAPJAX, *written(tmp_path, 1), "--distributed"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "no process of a job" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize("at_once", [None, 1, 3, 7, 100])
def test_batches_hold_each_recording_once(at_once):
    stacked = {"a": jnp.arange(14.0).reshape(7, 2), "b": jnp.arange(7)}
    found = each(
        lambda s, r: {"sum": s * r["a"] + r["b"].astype(s.dtype)}, jnp.float64(2), stacked, None, at_once
    )
    np.testing.assert_array_equal(found["sum"], 2 * stacked["a"] + np.arange(7.0)[:, None])


@pytest.mark.slow
def test_devices_share_recordings_evenly_or_not():
    program = """
import jax, numpy as np
from dataclasses import dataclass
from typing import Any
from functools import partial
from hapjax_fitting.sharding import each, gathered, over_devices
@partial(jax.tree_util.register_dataclass, data_fields=["value"], meta_fields=["layout"])
@dataclass
class Group:
    value: Any
    layout: Any = None
few, many = over_devices([Group(np.arange(3.0)), Group(np.arange(14.0).reshape(7, 2))])
for group, count, rows in ((few, 3, 1), (many, 7, 2)):
    assert len(group.value.addressable_shards) == 4 and group.value.addressable_shards[0].data.shape[0] == rows
    for at_once in (None, 1):
        found = jax.jit(lambda g: each(lambda s, r: s * r.value, 2.0, g, g.layout, at_once))(group)
        assert np.array_equal(gathered(found), 2 * np.asarray(group.value)[:count])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=on_devices(4))
    assert done.returncode == 0, done.stderr
