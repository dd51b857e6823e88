#!/usr/bin/env bash
# Learners' scores under shifts in docs/shift-curves.md and methods/relational/TRIED.md: tools/shifts.sh. About eight hours of one core; run again, it goes on.
set -euo pipefail
export MAGICAL_MJ_RENDERER=software

# NAME RUN TASK EPISODES SHIFTS PRESET METHOD [OPTIONS OF THE TRAINING]
run() {
  local policy=runs/shifts/$1-$3-$2
  [ -f "$policy.trained" ] || {
    magical-mj train "$7" --tasks "$3" --seed "$2" --preset "$6" --out "$policy" "${@:8}"
    touch "$policy.trained"
  }
  magical-mj evaluate --policy "$1=$policy" --run "$2" --tasks "$3" --variants Demo --preset "$6" --episodes "$4" \
    --shifts "$5" --out "$policy-scores" --resume
}

for task in MoveToCorner MoveToRegion MatchRegions MakeLine FindDupe FixColour ClusterColour ClusterShape; do
  shifts=clutter,latency,slip,friction  # what is seen does not change states
  [ $task = MoveToCorner ] || shifts=pose,$shifts  # it has no Layout
  run BC-states 0 $task 50 $shifts State bc
  case $task in MoveToCorner | MoveToRegion | FixColour)
    [ $task != MoveToRegion ] || for seed in 0 1 2 3 4; do run GAIL $seed $task 50 $shifts State gail; done
    for seed in 1 2 3 4; do run BC-states $seed $task 50 $shifts State bc; done
    for seed in 0 1 2 3 4; do run relational $seed $task 50 $shifts State relational; done ;;
  FindDupe | MatchRegions | MakeLine) run relational 0 $task 50 $shifts State relational ;;
  esac
done
for task in MoveToRegion FindDupe; do
  for seed in 0 1 2 3 4; do run BC $seed $task 20 all LoRes4E bc --quick; done
  for seed in 0 1 2 3 4; do run redraw $seed $task 20 all LoRes4E redraw --quick; done
  run BC-no-trans-rot 0 $task 20 all LoRes4E bc --quick --augment no-trans-rot
  run BC-allo 0 $task 20 all LoRes4A bc --quick
done
magical-mj report runs/shifts/{BC-states,relational}-{MoveToCorner,MoveToRegion,FixColour}-?-scores --out runs/shifts/three
magical-mj report runs/shifts/BC-states-*-0-scores --out runs/shifts/states
magical-mj report runs/shifts/{BC,redraw}-{MoveToRegion,FindDupe}-?-scores --out runs/shifts/runs
magical-mj report runs/shifts/BC{,-no-trans-rot,-allo}-{MoveToRegion,FindDupe}-0-scores --mixed-presets --out runs/shifts/pictures
