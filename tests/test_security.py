"""What a file may never do: run code, leave its folder, or lie open while it is written."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from umbra_bench.results import replacing, together

PACKAGE = Path(__file__).resolve().parent.parent / "umbra_bench"
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "shelve", "marshal", "joblib", "cloudpickle"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
ALLOWED = {
    # The gate's self-test compiles the project's own source with one change of its own catalogue.
    "self_test.py": {"exec", "compile"},
}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: path.name)
def test_nothing_that_is_read_becomes_code(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not {alias.name.split(".")[0] for alias in node.names} & FORBIDDEN_MODULES
        if isinstance(node, ast.ImportFrom):
            assert (node.module or "").split(".")[0] not in FORBIDDEN_MODULES
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name):
                assert node.func.id not in FORBIDDEN_CALLS - ALLOWED.get(path.name, set())
            words = {word.arg: word.value for word in node.keywords}
            for name in ("allow_pickle", "shell"):
                value = words.get(name)
                assert value is None or (isinstance(value, ast.Constant) and value.value is False)


def test_temporary_files_are_private_until_they_are_in_place(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.json") as temporary:
        assert temporary.stat().st_mode & 0o777 == 0o600
        temporary.write_text("{}", encoding="utf-8")
    with together(tmp_path, "a") as fresh:
        assert fresh.stat().st_mode & 0o777 == 0o700
        (fresh / "b.json").write_text("{}", encoding="utf-8")
    assert (tmp_path / "b.json").read_text(encoding="utf-8") == "{}"
