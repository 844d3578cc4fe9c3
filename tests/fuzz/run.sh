#!/usr/bin/env bash
# Runs fuzz targets one after the other for some seconds each, and prints the executions, the coverage and the findings.
#
#     tests/fuzz/run.sh SECONDS [TARGET...]
#
# Without targets, all are run. Logs go to tests/fuzz/logs, findings to tests/fuzz/artifacts/TARGET. Fails if there were
# findings. SANITIZER=address also finds single allocations beyond the limit, at half the speed.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=$1
shift
fuzz=tests/fuzz
options=(-O --sanitizer "${SANITIZER:-none}" --fuzz-dir $fuzz)
limits=(-timeout=5 -rss_limit_mb=4000 -max_len=65536)
mkdir -p $fuzz/logs
if [ $# = 0 ]; then mapfile -t targets < <(cargo +nightly fuzz list --fuzz-dir $fuzz); else targets=("$@"); fi

cargo +nightly fuzz build "${options[@]}"
failed=0
printf '%-12s %12s %9s %9s %s\n' target executions edges features findings
for target in "${targets[@]}"; do
    log=$fuzz/logs/$target.log
    mkdir -p "$fuzz/corpus/$target"
    arguments=("${limits[@]}" "-max_total_time=$seconds" -print_final_stats=1)
    if [ -s "$fuzz/corpus/$target.dict" ]; then arguments+=("-dict=$fuzz/corpus/$target.dict"); fi
    # A finding ends the target's run
    code=0
    cargo +nightly fuzz run "${options[@]}" "$target" -- "${arguments[@]}" >"$log" 2>&1 || code=$?
    executions=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log" | tail -1)
    coverage=$(sed -n 's/.* cov: \([0-9]*\) ft: \([0-9]*\) .*/\1 \2/p' "$log" | tail -1)
    finding=$(sed -n 's/.*Test unit written to //p' "$log" | tail -1)
    if [ $code != 0 ]; then failed=1 finding=${finding:-"exit code $code, see $log"}; fi
    printf '%-12s %12s %9s %9s %s\n' "$target" "${executions:-0}" "${coverage% *}" "${coverage#* }" "${finding:-none}"
done
exit $failed
