"""Who computes a call of a compiled program on a CPU: another thread, as JAX comes, or the thread that calls."""

import jax


def compute_at_once() -> None:
    """From now on, in this whole process, a compiled program on a CPU is computed by the thread that calls it.

    As JAX comes, any program of 1000 operations or more is handed to another thread. That one has to be woken, has not the
    caller's priority, and waits for a processor like any other: on a busy machine a servo loop loses more to it than to
    the step. A loop's process calls this once, before anything is computed; later it has no effect. The commands
    of `hapjax` that measure or run loops do.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)
