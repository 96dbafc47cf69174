# Steps of a check, for bash: sourced by tools/check and .ci/run.

# Run a command, and print one line when it is done: wall time, CPU time of all its processes, and its last line; for
# pytest also what was skipped and why. Print all its output where it fails.
step() {
    local name=$1 code=0 log spent TIMEFORMAT='%R %U %S'
    shift
    log=$(mktemp)
    spent=$({ time "$@" >"$log" 2>&1; } 2>&1) || code=$?
    spent=$(awk '{ printf "%.0f s, %.1f s of CPU", $1, $2 + $3 }' <<<"$spent")
    if [ "$code" = 0 ]; then
        echo "$name: good after $spent: $(tail -n 1 "$log")"
        sed -n '/^=* short test summary/,$ { /^SKIPPED/p }' "$log"
    else
        cat "$log"
        echo "$name: failed with exit code $code after $spent"
    fi
    rm -f "$log"
    return "$code"
}

# Set up .venv for developers, and compile what all steps behind it would else compile each by itself.
prepare() {
    export PIP_COMPILE=0 # few of the modules are ever imported, and those are compiled then
    step "set-up" tools/setup dev
    unset PYTHONDONTWRITEBYTECODE
    export PYTHONPYCACHEPREFIX=$PWD/.venv/pycache
    step "kernels" .venv/bin/vlp16emu cache --compile
}
