#!/usr/bin/env bash
# Learners' scores under shifts in docs/shifts.md: experiments/shifts.sh. About three hours of one core; run again, it goes on.
set -euo pipefail
export MAGICAL_MJ_RENDERER=software

# NAME TASK EPISODES SHIFTS PRESET METHOD [OPTIONS OF THE TRAINING]
run() {
  local policy=runs/shifts/$1-$2
  [ -f "$policy.trained" ] || { magical-mj train "$6" --tasks "$2" --preset "$5" --out "$policy" "${@:7}"; touch "$policy.trained"; }
  magical-mj evaluate --policy "$1=$policy" --tasks "$2" --variants Demo --preset "$5" --episodes "$3" --shifts "$4" \
    --out "$policy-scores" --resume
}

for task in MoveToCorner MoveToRegion MatchRegions MakeLine FindDupe FixColour ClusterColour ClusterShape; do
  shifts=clutter,latency,slip,friction  # what is seen does not change states
  [ $task = MoveToCorner ] || shifts=pose,$shifts  # it has no Layout
  run BC-states $task 50 $shifts State bc
  case $task in MoveToCorner | MoveToRegion | FixColour)
    run relational $task 50 $shifts State relational
    run GAIL $task 50 $shifts State gail ;;
  esac
done
for task in MoveToRegion FindDupe; do
  run BC $task 20 all LoRes4E bc --quick
  run BC-no-trans-rot $task 20 all LoRes4E bc --quick --augment no-trans-rot
  run BC-allo $task 20 all LoRes4A bc --quick
done
magical-mj report runs/shifts/{BC-states,relational,GAIL}-{MoveToCorner,MoveToRegion,FixColour}-scores --out runs/shifts/three
magical-mj report runs/shifts/BC-states-*-scores --out runs/shifts/states
magical-mj report runs/shifts/BC{,-no-trans-rot,-allo}-{MoveToRegion,FindDupe}-scores --mixed-presets --out runs/shifts/pictures
