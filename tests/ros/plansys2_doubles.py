"""Doubles of PlanSys2's messages: plain objects with the messages' attributes, as a program without ROS has them."""

from types import SimpleNamespace

DOMAIN = """
(define (domain delivery)
  (:requirements :strips :typing :fluents :durative-actions :derived-predicates)
  (:types robot item room - object
          dock - room)
  (:constants hub - dock)
  (:predicates (robot_at ?r - robot ?p - room) (item_at ?i - item ?p - room) (holding ?r - robot ?i - item)
               (free ?r - robot) (busy ?r - robot))
  (:functions (battery ?r - robot) (trips))
  (:derived (busy ?r - robot) (exists (?i - item) (holding ?r ?i)))
  (:durative-action move
    :parameters (?r - robot ?from ?to - room)
    :duration (= ?duration 10)
    :condition (and (at start (robot_at ?r ?from)) (over all (>= (battery ?r) 0)))
    :effect (and (at start (not (robot_at ?r ?from))) (at end (robot_at ?r ?to)) (at end (decrease (battery ?r) 5))))
  (:durative-action wait
    :parameters ()
    :duration (>= ?duration 1)
    :condition ()
    :effect (at end (increase (trips) 1)))
  (:action grab
    :parameters (?r - robot ?i - item ?p - room)
    :precondition (and (robot_at ?r ?p) (item_at ?i ?p) (free ?r))
    :effect (and (holding ?r ?i) (not (item_at ?i ?p)) (not (free ?r)))))
"""


def knowledge(instances="", predicates=(), functions=(), goal=""):
    """A `Knowledge`."""
    return SimpleNamespace(
        instances=instances.split(), predicates=list(predicates), functions=list(functions), goal=goal
    )


def stamp(nanoseconds):
    """A `Time` or a `Duration`."""
    return SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def info(status, start, action, name=None, duration=0, message="", at=None):
    """An `ActionExecutionInfo` of an action as text, ``(move r1 a b)``; times in nanoseconds."""
    words = action.strip("()").split()
    return SimpleNamespace(
        status=status,
        start_stamp=stamp(start),
        status_stamp=stamp(start if at is None else at),
        action_full_name=name or f"{action}:0",
        action=words[0],
        arguments=words[1:] or words,
        duration=stamp(duration),
        completion=0.0,
        message_status=message,
    )


def hub(kind, action, success=False, status="", node_id="move_performer"):
    """An `ActionExecution`."""
    words = action.strip("()").split()
    return SimpleNamespace(
        type=kind,
        node_id=node_id,
        action=words[0],
        arguments=words[1:] or words,
        success=success,
        completion=1.0 if success else 0.0,
        status=status,
    )


def plan(*steps):
    """A `Plan` of (time, action, duration), in seconds."""
    return SimpleNamespace(
        items=[SimpleNamespace(time=time, action=action, duration=duration) for time, action, duration in steps]
    )


def param(name, type_name="", sub_types=()):
    """A `Param`."""
    return SimpleNamespace(name=name, type=type_name, sub_types=list(sub_types))


def node(node_type=0, name="", *arguments, value=0.0, children=(), expression_type=0, modifier_type=0, negate=False):
    """A `Node`; its arguments are `Param`s without types."""
    return SimpleNamespace(
        node_type=node_type,
        expression_type=expression_type,
        modifier_type=modifier_type,
        node_id=0,
        children=list(children),
        name=name,
        parameters=[param(argument) for argument in arguments],
        value=value,
        negate=negate,
    )


def tree(*nodes):
    """A `Tree`, the root first."""
    for number, found in enumerate(nodes):
        found.node_id = number
    return SimpleNamespace(nodes=list(nodes))
