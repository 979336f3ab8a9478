"""Domains for random plans: classical with all of ADL, numeric, and temporal with continuous effects.

Kairos plans linear continuous effects only where the moved functions are read in one direction; these domains comply.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass

LIGHTS = """
(define (domain lights)
  (:requirements :adl)
  (:types room - object hall - room)
  (:predicates (beside ?a ?b - room) (lit ?r - room) (broken ?r - room) (pressed) (in ?r - room) (dark))
  (:action press :parameters (?r - room)
    :precondition (and (in ?r) (or (not (broken ?r)) (exists (?n - room) (and (beside ?r ?n) (lit ?n)))))
    :effect (and (pressed) (not (dark))
      (when (lit ?r) (not (lit ?r))) (when (not (lit ?r)) (lit ?r))
      (forall (?n - room) (when (beside ?r ?n)
        (and (when (lit ?n) (not (lit ?n))) (when (not (lit ?n)) (lit ?n)))))))
  (:action walk :parameters (?a ?b - room)
    :precondition (and (in ?a) (not (= ?a ?b)) (imply (not (beside ?a ?b)) (beside ?b ?a)))
    :effect (and (not (in ?a)) (in ?b)))
  (:action blackout :parameters (?h - hall)
    :precondition (and (in ?h) (pressed) (forall (?r - hall) (lit ?r)))
    :effect (and (forall (?r - room) (not (lit ?r))) (dark) (not (pressed)))))
"""

JUGS = """
(define (domain jugs)
  (:requirements :typing :fluents :negative-preconditions :conditional-effects :equality)
  (:types jug)
  (:predicates (rinsed ?j - jug) (full ?j - jug))
  (:functions (amount ?j - jug) (size ?j - jug) (poured) (price))
  (:action fill :parameters (?j - jug) :precondition (< (amount ?j) (size ?j))
    :effect (and (increase (poured) (- (size ?j) (amount ?j))) (assign (amount ?j) (size ?j)) (full ?j)
      (increase (price) 2.5)))
  (:action empty :parameters (?j - jug) :precondition (> (amount ?j) 0)
    :effect (and (assign (amount ?j) 0) (not (full ?j)) (rinsed ?j) (scale-up (price) 1.5)))
  (:action pour :parameters (?a ?b - jug)
    :precondition (and (not (= ?a ?b)) (> (amount ?a) 0) (< (amount ?b) (size ?b)))
    :effect (and (not (full ?a)) (decrease (price) 0.25)
      (when (<= (+ (amount ?a) (amount ?b)) (size ?b))
        (and (assign (amount ?b) (+ (amount ?b) (amount ?a))) (assign (amount ?a) 0)))
      (when (> (+ (amount ?a) (amount ?b)) (size ?b))
        (and (assign (amount ?a) (- (amount ?a) (- (size ?b) (amount ?b)))) (assign (amount ?b) (size ?b))))
      (when (>= (+ (amount ?a) (amount ?b)) (size ?b)) (full ?b))))
  (:action settle :parameters ()
    :precondition (and (> (price) 1) (forall (?j - jug) (rinsed ?j)))
    :effect (and (scale-down (price) 4) (forall (?j - jug) (when (= (amount ?j) 0) (not (rinsed ?j)))))))
"""

CRANES = """
(define (domain cranes)
  (:requirements :adl :typing :fluents :durative-actions :duration-inequalities :continuous-effects
                 :timed-initial-literals)
  (:types crane tank - object dock)
  (:predicates (free ?c - crane) (at_dock ?c - crane ?d - dock) (near ?a ?b - dock) (tide) (loud ?d - dock)
               (filling ?t - tank) (filled ?t - tank) (lifted ?d - dock))
  (:functions (fuel ?c - crane) (level ?t - tank) (speed ?c - crane) (moves) (log))
  (:action refuel :parameters (?c - crane ?t - tank)
    :precondition (and (free ?c) (>= (level ?t) 3))
    :effect (and (decrease (level ?t) 3) (increase (fuel ?c) (* 3 (speed ?c)))))
  (:durative-action travel :parameters (?c - crane ?a ?b - dock)
    :duration (= ?duration (/ 12 (speed ?c)))
    :condition (and (at start (free ?c)) (at start (at_dock ?c ?a)) (at start (near ?a ?b))
                    (at start (>= (fuel ?c) 5)))
    :effect (and (at start (not (free ?c))) (at start (not (at_dock ?c ?a))) (at end (free ?c))
                 (at end (at_dock ?c ?b)) (at end (increase (moves) 1)) (at end (assign (log) ?duration))
                 (decrease (fuel ?c) (* #t (speed ?c)))))
  (:durative-action lift :parameters (?c - crane ?d - dock)
    :duration (and (>= ?duration 2) (<= ?duration 6))
    :condition (and (at start (free ?c)) (over all (at_dock ?c ?d)) (at start (tide)) (at start (>= (fuel ?c) 4)))
    :effect (and (at start (not (free ?c))) (at end (free ?c)) (at end (lifted ?d)) (at start (loud ?d))
                 (at start (decrease (fuel ?c) 1)) (decrease (fuel ?c) (* #t 0.5))
                 (at end (forall (?n - dock) (when (and (near ?d ?n) (loud ?n)) (not (loud ?n)))))
                 (at end (when (tide) (increase (moves) (/ ?duration 2))))))
  (:durative-action pump :parameters (?t - tank)
    :duration (and (>= ?duration 1) (<= ?duration 9))
    :condition (at start (not (filling ?t)))
    :effect (and (at start (filling ?t)) (at end (not (filling ?t))) (at end (filled ?t))
                 (increase (level ?t) (* #t 0.75))))
  (:durative-action drip :parameters (?t - tank)
    :duration (= ?duration 7)
    :effect (and (increase (level ?t) (* #t 0.125)) (at end (increase (log) 1)))))
"""

TANKS = """
(define (domain tanks)
  (:requirements :adl :typing :fluents :durative-actions :duration-inequalities :continuous-effects
                 :timed-initial-literals)
  (:types tank)
  (:predicates (sealed ?t - tank) (calm) (tested ?t - tank))
  (:functions (level ?t - tank) (inflow ?t - tank) (limit ?t - tank) (used))
  (:action open-valve :parameters (?t - tank) :precondition (calm) :effect (increase (inflow ?t) 0.5))
  (:action close-valve :parameters (?t - tank) :precondition (>= (inflow ?t) 0) :effect (decrease (inflow ?t) 1))
  (:action unseal :parameters (?t - tank) :precondition (sealed ?t) :effect (not (sealed ?t)))
  (:action vent :parameters (?t - tank) :precondition (not (sealed ?t)) :effect (assign (level ?t) 1))
  (:action storm :parameters () :precondition (calm) :effect (not (calm)))
  (:action lull :parameters () :precondition () :effect (calm))
  (:durative-action fill :parameters (?t - tank)
    :duration (and (>= ?duration 1) (<= ?duration (limit ?t)))
    :condition (and (over all (<= (level ?t) 8)) (over all (or (calm) (sealed ?t))) (at end (>= (level ?t) 1)))
    :effect (and (increase (level ?t) (* #t (inflow ?t))) (at end (tested ?t))))
  (:durative-action cure :parameters (?t - tank)
    :duration (= ?duration (/ (limit ?t) 2))
    :condition (and (over all (sealed ?t)) (at end (tested ?t)) (at end (calm)))
    :effect (and (at end (increase (used) 1)) (decrease (level ?t) (* #t 0.25))))
  (:durative-action hold :parameters (?t - tank)
    :duration (and (>= ?duration 2) (<= ?duration 6))
    :condition (and (at start (not (sealed ?t))) (over all (sealed ?t)) (over all (>= (level ?t) 0)))
    :effect (and (at start (sealed ?t)) (at end (not (sealed ?t))) (at start (increase (used) 0.5)))))
"""


@dataclass(frozen=True)
class World:
    """A domain, and problems of it made from a random generator."""

    domain: str
    problem: Callable[[random.Random], str]


def lights(rng: random.Random) -> str:
    """Five rooms in a ring with some shortcuts; the goal is a pattern of light."""
    rooms = [f"r{i}" for i in range(4)]
    ring = [(rooms[i], rooms[i - 1]) for i in range(4)] + [(rooms[0], rooms[2])]
    init = [f"(beside {a} {b})" for a, b in ring] + [f"(beside {b} {a})" for a, b in ring if rng.random() < 0.5]
    init += [f"(lit {r})" for r in rooms if rng.random() < 0.5] + [f"(in {rng.choice(rooms)})"]
    init += [f"(broken {r})" for r in rooms if rng.random() < 0.3]
    goal = rng.choice(
        ["(dark)", "(and (lit r0) (not (lit r1)))", "(and (in r3) (pressed))", "(forall (?r - room) (not (lit ?r)))"]
    )
    return _problem("lights", f"{' '.join(rooms[:2])} - room {' '.join(rooms[2:])} - hall", init, goal)


def jugs(rng: random.Random) -> str:
    """Three jugs; the goal is an amount in one of them."""
    names = ["small", "medium", "large"]
    sizes = [3, 5, 7.5]
    init = [f"(= (size {j}) {s})" for j, s in zip(names, sizes, strict=True)]
    init += [f"(= (amount {j}) {rng.randint(0, 3)})" for j in names]
    init += ["(= (poured) 0)", "(= (price) 0)", "(rinsed large)"]
    goal = rng.choice(
        [
            "(= (amount medium) 4)",
            "(and (> (amount large) 5) (not (full large)) (rinsed small))",
            "(and (< (price) 1) (> (poured) 6))",
            "(and (forall (?j - jug) (> (amount ?j) 1)) (full small))",
        ]
    )
    return _problem("jugs", f"{' '.join(names)} - jug", init, goal)


def cranes(rng: random.Random) -> str:
    """Two cranes, three docks, two tanks, and a tide that comes and goes."""
    init = ["(near d0 d1)", "(near d1 d2)", "(near d1 d0)", "(near d2 d1)", "(at_dock c0 d0)", "(at_dock c1 d2)"]
    init += ["(free c0)", "(free c1)", f"(= (fuel c0) {rng.randint(15, 40)})", f"(= (fuel c1) {rng.randint(15, 40)})"]
    init += ["(= (speed c0) 1.5)", "(= (speed c1) 2)", "(= (moves) 0)", "(= (log) 0)"]
    init += [f"(= (level t0) {rng.randint(0, 9)})", "(= (level t1) 0.5)"]
    low = rng.randint(20, 40)
    init += [f"(at {rng.randint(2, 9)} (tide))", f"(at {low} (not (tide)))", f"(at {low + 20}.5 (tide))"]
    init += ["(at 12.25 (= (level t1) 4))", f"(at {rng.randint(3, 9)}.125 (loud d1))"]
    goals = rng.sample(["(lifted d0)", "(lifted d1)", "(filled t1)", "(at_dock c1 d0)", "(>= (level t0) 11)"], 2)
    return _problem("cranes", "c0 c1 - crane t0 t1 - tank d0 d1 d2 - dock", init, f"(and {' '.join(goals)})")


def tanks(rng: random.Random) -> str:
    """Two tanks, and a storm that comes and goes."""
    init = [f"(= (level {t}) {rng.randint(0, 4)})" for t in ("t0", "t1")]
    init += [f"(= (inflow {t}) {rng.choice([-0.5, 0.5, 1, 1.5])})" for t in ("t0", "t1")]
    init += ["(= (limit t0) 5)", f"(= (limit t1) {rng.choice([3, 8])})", "(= (used) 0)", "(calm)"]
    init += [f"(sealed {t})" for t in ("t0", "t1") if rng.random() < 0.7] + ["(tested t0)"]
    start = rng.randint(4, 20)
    init += [f"(at {start}.0625 (not (calm)))", f"(at {start + 3}.0625 (calm))"]
    init += [f"(at {start + 1}.1875 (= (inflow t1) 1))"]
    return _problem("tanks", "t0 t1 - tank", init, "(tested t1)")


def _problem(domain: str, objects: str, init: list[str], goal: str) -> str:
    return f"(define (problem p) (:domain {domain}) (:objects {objects}) (:init {' '.join(init)}) (:goal {goal}))"


WORLDS = {
    "lights": World(LIGHTS, lights),
    "jugs": World(JUGS, jugs),
    "cranes": World(CRANES, cranes),
    "tanks": World(TANKS, tanks),
}
