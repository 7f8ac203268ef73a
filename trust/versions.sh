#!/usr/bin/env bash
# The gate with other versions of Python and of the libraries, each in a folder of its own outside the
# project: the pinned versions on each Python, and the oldest that pyproject.toml allows.
#
#     trust/versions.sh [python3.11 python3.12 python3.13]
#
# It needs the package registry and some minutes a version, so neither the suite nor `make trust` runs it.
set -uo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
status=0

oldest() {  # every dependency at its lower bound
    "$1" - <<'PYTHON'
import tomllib
project = tomllib.load(open("pyproject.toml", "rb"))["project"]
print(*(dependency.replace(">=", "==") for dependency in project["dependencies"]), sep="\n")
PYTHON
}

try() {  # NAME PYTHON CONSTRAINTS
    local name=$1 python=$2 constraints=$3
    "$python" -m venv "$work/$name" &&
        PIP_CONSTRAINT=$constraints "$work/$name/bin/pip" install --quiet --disable-pip-version-check . \
            >"$work/$name.log" 2>&1 ||
        { echo "$name: cannot be installed: $(tail -n 1 "$work/$name.log")"; status=2; return; }
    "$work/$name/bin/umbra-bench" gate --baseline "$PWD/results/baseline.json" \
        --results "$work/$name-results" >"$work/$name.log" 2>&1
    local code=$?
    [ "$code" -eq 0 ] || status=1
    echo "$name: $("$work/$name/bin/python" --version), gate exit $code: $(grep '^gate:' "$work/$name.log" || tail -n 1 "$work/$name.log")"
    [ -f "$work/$name-results/gate.json" ] && "$work/$name/bin/python" - "$work/$name-results/gate.json" <<'PYTHON'
import json
import sys
# The worst: the largest part of what is allowed beyond the baseline that a number takes.
rows = [j for j in json.load(open(sys.argv[1]))["judgements"]
        if all(isinstance(j[k], float) for k in ("baseline", "now", "allowed")) and j["allowed"] > j["baseline"]]
share = lambda j: (j["now"] - j["baseline"]) / (j["allowed"] - j["baseline"])
worst = max(rows, key=share)
print(f"  worst of {len(rows)}: {worst['cell']} {worst['metric']}: {share(worst):.3g} of the tolerance")
PYTHON
}

for python in "${@:-python3.11 python3.12 python3.13}"; do
    for each in $python; do
        command -v "$each" >/dev/null && "$each" --version >/dev/null 2>&1 || { echo "$each: not here"; continue; }
        try "pinned-$(basename "$each")" "$each" "$PWD/constraints.txt"
    done
done
lowest=$(command -v python3.11 || command -v python3)
oldest "$lowest" >"$work/oldest.txt"
try "oldest" "$lowest" "$work/oldest.txt"
exit "$status"
