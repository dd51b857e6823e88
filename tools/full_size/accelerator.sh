#!/usr/bin/env bash
# Trains and evaluates the paper's 11 methods in its sizes, the most wanted first, for a limited time. Call it again to
# go on where it stopped: a finished run is not repeated, and an unfinished one continues. Ctrl-C and SIGTERM stop it
# as the end of the time does.
#   tools/full_size/accelerator.sh 840 12 runs    # for so many seconds, so many runs side by side, into this folder
#   tools/full_size/accelerator.sh 840 12 runs pixels-gail pixels-al    # some of the methods, in this order
# Runs side by side share the card: one alone keeps it waiting for its small kernels to be launched.
set -uo pipefail
usage="usage: tools/full_size/accelerator.sh SECONDS JOBS FOLDER [TABLE ...]"
seconds=${1:?$usage} jobs=${2:?$usage} out=${3:?$usage} status=0 stopped=
shift 3
[ $# -gt 0 ] || set -- pixels-bc pixels-gail pixels-bc-multi pixels-gail-multi pixels-bc-no-augmentation \
    pixels-bc-no-trans-rot pixels-bc-allo pixels-gail-no-augmentation pixels-gail-allo pixels-wgail-gp pixels-al
mkdir -p "$out" || exit
stop() {
  stopped=yes
  kill -INT "$child"  # timeout passes it on to all processes of the experiment, which save their trainings
  wait "$child"
}
for table; do
  left=$((seconds - SECONDS))
  [ "$left" -gt 0 ] && [ -z "$stopped" ] || break
  # In the background, because the shell handles signals only when a command in the foreground has ended.
  timeout --signal=INT --kill-after=20 "$left" \
    magical-mj experiment "$(dirname "$0")/$table.toml" --jobs "$jobs" --out "$out/$table" &
  child=$!
  trap stop INT TERM HUP
  wait "$child"
  code=$?
  trap - INT TERM HUP
  case $code in 124 | 137) [ "$SECONDS" -lt "$seconds" ] || break ;; esac  # timeout's codes, if the time is over
  [ "$code" -eq 0 ] || status=$code
done
cd "$out" && find . -path '*/evaluations/*' -type f | tar -czf evaluations.tar.gz -T -  # all that tables are made of
exit "$status"
