#!/usr/bin/env bash
# The figures of docs/pictures.md: two trainings, each with its own renderer, and both policies played with either.
# tools/renderers.sh takes a quarter of an hour of two cores; run again, it goes on.
set -euo pipefail

for learnt in opengl software; do
  policy=runs/renderers/bc-$learnt
  [ -f "$policy.trained" ] ||
    { magical-mj train bc --tasks MoveToRegion --quick --renderer $learnt --set evaluations=0 --out "$policy"; touch "$policy.trained"; }
  for played in opengl software; do
    magical-mj evaluate --policy "$policy" --tasks MoveToRegion --variants Demo,Jitter,Layout,Colour \
      --renderer $played --out "$policy-$played" --resume
  done
done
