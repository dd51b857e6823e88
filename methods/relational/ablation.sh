#!/usr/bin/env bash
# The effect of each assumption of relational, measured by leaving it out (TRIED.md): methods/relational/ablation.sh
# Two tasks, 100 episodes. About 25 minutes on one core. If it is run again, it continues.
set -euo pipefail

# NAME ASSUMPTIONS
run() {
  for task in MoveToRegion FixColour; do
    local policy=runs/ablation/$task-$1
    [ -f "$policy.trained" ] || {
      magical-mj train relational --tasks $task --preset State --set evaluations=0 --set relational.assumptions="$2" \
        --out "$policy"; touch "$policy.trained"
    }
    magical-mj evaluate --policy "$1=$policy" --tasks $task --variants Demo,Layout,All --preset State \
      --out "$policy-scores" --resume
  done
}

run all egocentric,mirror,rename,hindsight,grips,displace
run without-egocentric rename,hindsight,grips,displace  # mirror is tried only with it
run without-mirror egocentric,rename,hindsight,grips,displace
run without-rename egocentric,mirror,hindsight,grips,displace
run without-hindsight egocentric,mirror,rename,grips,displace
run without-grips egocentric,mirror,rename,hindsight,displace
run without-displace egocentric,mirror,rename,hindsight,grips
magical-mj report runs/ablation/*-scores --out runs/ablation/report
