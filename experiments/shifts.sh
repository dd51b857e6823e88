#!/usr/bin/env bash
# The scores of BC under shifts in docs/shifts.md: experiments/shifts.sh. About two hours of one core; run again, it goes on.
set -euo pipefail
export MAGICAL_MJ_RENDERER=software

# METHOD TASK EPISODES SHIFTS PRESET [OPTIONS OF THE TRAINING]
run() {
  local policy=runs/shifts/$1-$2
  [ -f "$policy.trained" ] || { magical-mj train bc --tasks "$2" --preset "$5" --out "$policy" "${@:6}" && touch "$policy.trained"; }
  magical-mj evaluate --policy "$1=$policy" --tasks "$2" --variants Demo --preset "$5" --episodes "$3" --shifts "$4" \
    --out "$policy-scores" --resume
}

for task in MoveToCorner MoveToRegion MatchRegions MakeLine FindDupe FixColour ClusterColour ClusterShape; do
  shifts=clutter,latency,slip,friction  # what is seen does not change states
  [ $task = MoveToCorner ] || shifts=pose,$shifts  # it has no Layout
  run BC-states $task 50 $shifts State
done
for task in MoveToRegion FindDupe; do
  run BC $task 20 all LoRes4E --quick
  run BC-no-trans-rot $task 20 all LoRes4E --quick --augment no-trans-rot
  run BC-allo $task 20 all LoRes4A --quick
done
magical-mj report runs/shifts/BC-states-*-scores --out runs/shifts/states
magical-mj report runs/shifts/BC{,-no-trans-rot,-allo}-{MoveToRegion,FindDupe}-scores --mixed-presets --out runs/shifts/pictures
