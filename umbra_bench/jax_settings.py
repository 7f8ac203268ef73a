"""The one place where JAX's global state is touched.

Truth is computed in float64 and UMBRA's own runs in float32, side by side. Both run inside
:func:`float64_allowed`, a context that leaves the caller's settings as they were: importing or using
this package from Python changes no default of JAX. Only the command line, which owns its process,
calls :func:`keep_compiled_code`.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from typing import Any

import jax
import platformdirs


def float64_allowed() -> AbstractContextManager[None]:
    """A context in which float64 arrays stay float64; float32 arrays stay float32."""
    return jax.enable_x64(True)


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
