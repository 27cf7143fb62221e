"""Compares exported models with exported transition systems, by Storm (pip install stormpy==2.0.0).

python verify/tests/exports/storm.py FOLDER

For each NAME.jani in the folder Storm builds the state space; NAME.aut is the explorer's. Both are deterministic but for inert silent
changes, which is checked here too, so they are branching bisimilar when the same words are possible in all pairs of states that a
walk through both meets.
"""

import pathlib
import re
import sys

import stormpy
from stormpy import developer


def build(path):
    """The words and targets of each state, a word of None being silent, as Storm sees them."""
    program, _ = stormpy.parse_jani_model(str(path))
    options = developer.BuilderOptions()
    options.set_build_choice_labels(True)
    model = stormpy.build_model(program, options=options)
    stuck = model.labeling.get_states("deadlock") if "deadlock" in model.labeling.get_labels() else []
    edges = [[] for _ in range(model.nr_states)]
    for state in model.states:
        if state.id in stuck:
            continue
        for action in state.actions:
            words = model.choice_labeling.get_labels_of_choice(model.get_choice_index(state.id, action.id))
            (target,) = [entry.column for entry in action.transitions]
            edges[state.id].append((next(iter(words), None), target))
    (first,) = model.initial_states
    return edges, first


def aut(path):
    edges = {}
    for line in path.read_text().splitlines()[1:]:
        source, word, target = re.fullmatch(r'\((\d+), "(.*)", (\d+)\)', line).groups()
        assert word not in edges.setdefault(int(source), {}), f"{word} twice"
        edges[int(source)][word] = int(target)
    return edges


def settled(edges, state):
    """The state at the end of the silent changes, of which there must be one at a time, and an end."""
    for _ in range(len(edges)):
        if all(word is not None for word, _ in edges[state]):
            return state
        assert len(edges[state]) == 1, "another change beside a silent one"
        state = edges[state][0][1]
    raise AssertionError("silent changes without end")


def compare(jani_path):
    ours, first = build(jani_path)
    theirs = aut(jani_path.with_suffix(".aut"))
    known, open_pairs = set(), [(0, settled(ours, first))]
    while open_pairs:
        pair = open_pairs.pop()
        if pair in known:
            continue
        known.add(pair)
        at, state = pair
        words = dict(ours[state])
        assert len(words) == len(ours[state]), "a word twice"
        assert words.keys() == theirs.get(at, {}).keys(), f"{sorted(words)} and {sorted(theirs.get(at, {}))}"
        open_pairs.extend((theirs[at][word], settled(ours, target)) for word, target in words.items())
    return len(known), len(ours)


def main():
    paths = sorted(pathlib.Path(sys.argv[1]).glob("*.jani"))
    different, pairs, states = 0, 0, 0
    for path in paths:
        try:
            met, built = compare(path)
            pairs, states = pairs + met, states + built
        except AssertionError as how:
            different += 1
            print(f"{path.name}: {how}")
    print(f"{len(paths) - different} the same, {different} different; {pairs} pairs of states, {states} states built by Storm")
    sys.exit(different > 0 or not paths)


main()
