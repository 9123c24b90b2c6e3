"""The same programs under several settings of XLA, which reads them when it starts: a process each, and they take turns."""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from typing import Any

import jax

from ..progress import Advance

AS_IT_IS, ROUNDS = "as it is", 10
ONE_THREAD = {"NPROC": "1"}
FLAGS = {
    "in order": "--xla_cpu_scheduler_type=CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    "loop flag": "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000",
}

Programs = Mapping[str, tuple[Callable[[], Any], float]]  # and s to compile each


def others() -> dict[str, dict[str, str]]:
    """The settings beside those of this process, on a CPU, each by itself; none that it has.

    `NPROC=1`: one thread. `in order`: kernels in an order that keeps memory small, of which few are ready at once for other
    threads to take. `loop flag`: a loop as one function.
    """
    flags, found = os.environ.get("XLA_FLAGS", ""), {}
    if jax.default_backend() != "cpu":
        return found
    if os.environ.get("NPROC") != ONE_THREAD["NPROC"]:
        found["NPROC=1"] = ONE_THREAD
    for name, flag in FLAGS.items():
        if flag not in flags:
            found[name] = {"XLA_FLAGS": f"{flags} {flag}".strip()}
    return found


def side_by_side(
    build: Callable[..., Programs],
    arguments: tuple[Any, ...],
    settings: Mapping[str, Mapping[str, str]],
    advance: Advance = lambda doing, steps: None,
) -> dict[str, dict[str, dict[str, float]]]:
    """Of each setting and program `run_s`, the least of several runs, its `ratio` to the setting's first program, and
    `compile_s`.

    Programs and settings take turns, so that a busy moment hits all alike. The first setting is that of this process.

    **Arguments:** `build(*arguments)`: the programs; it goes to other processes, so it is a module's own function.
    `settings`: of each further process, the variables of its environment that differ. `advance` is told of each
    setting whose programs are built, and of each of `ROUNDS`.
    """
    own = build(*arguments)
    advance("built", 1.0)
    compile_s = {AS_IT_IS: _compile_s(own)}
    with contextlib.ExitStack() as stack:
        pipes = {}
        for name, variables in settings.items():  # one after the other, so that compile times are alike
            pipes[name] = stack.enter_context(_process(build, arguments, variables))
            compile_s[name] = pipes[name].recv()
            advance(f"built, {name}", 1.0)
        rounds = []
        for _ in range(ROUNDS):
            taken = {AS_IT_IS: _round(own)}
            for name, pipe in pipes.items():
                pipe.send("go")
                taken[name] = pipe.recv()
            rounds.append(taken)
            advance(f"round {len(rounds)} of {ROUNDS}", 1.0)
    return {name: _least([taken[name] for taken in rounds[1:]], compile_s[name]) for name in compile_s}


def _least(rounds: list[dict[str, float]], compile_s: dict[str, float]) -> dict[str, dict[str, float]]:
    best = {name: min(taken[name] for taken in rounds) for name in compile_s}
    first = next(iter(best.values()))
    return {name: {"run_s": s, "ratio": s / first, "compile_s": compile_s[name]} for name, s in best.items()}


def _compile_s(programs: Programs) -> dict[str, float]:
    return {name: seconds for name, (_, seconds) in programs.items()}


def _round(programs: Programs) -> dict[str, float]:
    """s of one run of each."""
    taken = {}
    for name, (run, _) in programs.items():
        began = time.perf_counter()
        jax.block_until_ready(run())
        taken[name] = time.perf_counter() - began
    return taken


@contextlib.contextmanager
def _process(build, arguments: tuple[Any, ...], variables: Mapping[str, str]) -> Iterator[Connection]:
    """The pipe to a process of its own with these variables; it ends with the block."""
    fresh = multiprocessing.get_context("spawn")
    here, there = fresh.Pipe()
    child = fresh.Process(target=_serve, args=(there, build, arguments), daemon=True)
    with _environment({**variables, "JAX_ENABLE_X64": str(int(jax.config.read("jax_enable_x64")))}):
        child.start()
    there.close()
    try:
        yield here
    finally:
        here.close()
        child.join()


def _serve(pipe: Connection, build, arguments: tuple[Any, ...]) -> None:
    """Build, then run a round for each word that comes, until the other end is gone."""
    programs = build(*arguments)
    pipe.send(_compile_s(programs))
    with contextlib.suppress(EOFError):
        while pipe.recv():
            pipe.send(_round(programs))


@contextlib.contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Inside the block this process has these variables, and so has a process that it starts."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
