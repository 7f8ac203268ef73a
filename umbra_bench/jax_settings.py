"""The one place where JAX's global state is touched.

Truth is computed in float64 and UMBRA's own runs in float32, side by side. Both run inside
:func:`float64_allowed`, a context that leaves the caller's settings as they were: importing or using
this package from Python changes no default of JAX. Only the command line, which owns its process,
calls :func:`keep_compiled_code`.
"""

from __future__ import annotations

import functools
import os
from contextlib import AbstractContextManager
from typing import Any

import jax
import platformdirs


def float64_allowed() -> AbstractContextManager[None]:
    """A context in which float64 arrays stay float64; float32 arrays stay float32."""
    return jax.enable_x64(True)


CompilerOption = bool | int | str

FEWER_COPIES: dict[str, CompilerOption] = {"xla_cpu_copy_insertion_use_region_analysis": True}
"""Half of the copies that a loop makes of its state."""

WIDE_VECTORS: dict[str, CompilerOption] = {
    "xla_cpu_prefer_vector_width": 512,  # where the processor has them
    "xla_cpu_experimental_ynn_fusion_type": "",  # its sums cannot stand within one function
}


def compiler_options(wishes: dict[str, CompilerOption]) -> dict[str, CompilerOption]:
    """Those of our wishes that this version of XLA knows; without one the result is the same, slower."""
    return {name: value for name, value in wishes.items() if _is_known(name, value)}


@functools.cache
def _is_known(name: str, value: CompilerOption) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={name: value}).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def keep_compiled_code() -> None:
    """Keep compiled code between runs, in the user's cache folder, unless JAX was told where.

    Code that calls back into Python cannot be kept. Diffrax's solver does, to raise the errors of its
    own checks, unless Equinox is told, before it is imported, to answer a failed check with NaN.
    """
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        settings = {
            "jax_compilation_cache_dir": platformdirs.user_cache_dir("umbra-bench", "umbra-bench"),
            "jax_persistent_cache_min_compile_time_secs": 0.0,
            "jax_persistent_cache_min_entry_size_bytes": -1,
        }
        for name, value in settings.items():
            config.update(name, value)
            os.environ[name.upper()] = str(value)  # for the processes that this one starts
