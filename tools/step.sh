# Steps of a check, for bash: sourced by tools/check and .ci/run.

# Run a command, and print one line at its end: wall time, CPU time of all its processes, and its last line;
# for pytest also skipped tests with the reason. Print all its output if it fails.
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

# Set up .venv for developers, and compile once what each of the next steps would compile.
prepare() {
    export PIP_COMPILE=0 # few modules are ever imported; Python compiles these at import
    step "set-up" tools/setup dev
    unset PYTHONDONTWRITEBYTECODE
    export PYTHONPYCACHEPREFIX=$PWD/.venv/pycache
    step "kernels" .venv/bin/vlp16emu cache --compile
}
