; A porter robot in a hospital: it leaves its dock, drives between waypoints, passes a door that keeps hours,
; carries parcels and charges. Metres, seconds, percent.
(define (domain deliveries)
  (:requirements :strips :typing :fluents :durative-actions :continuous-effects :timed-initial-literals)
  (:types robot waypoint door parcel - object)

  (:predicates
    (robot_at ?r - robot ?wp - waypoint)
    (docked ?r - robot)
    (undocked ?r - robot)
    (dock_at ?wp - waypoint)
    (path ?from ?to - waypoint)
    (doorway ?d - door ?from ?to - waypoint)
    (open ?d - door)
    (parcel_at ?p - parcel ?wp - waypoint)
    (carries ?r - robot ?p - parcel)
    (delivered ?p - parcel ?wp - waypoint))

  (:functions
    (battery ?r - robot)
    (speed ?r - robot)
    (distance ?from ?to - waypoint))

  (:durative-action undock
    :parameters (?r - robot ?wp - waypoint)
    :duration (= ?duration 10)
    :condition (and (at start (docked ?r)) (at start (robot_at ?r ?wp)) (over all (dock_at ?wp)))
    :effect (and (at start (not (docked ?r))) (at end (undocked ?r))))

  (:durative-action dock
    :parameters (?r - robot ?wp - waypoint)
    :duration (= ?duration 10)
    :condition (and (at start (undocked ?r)) (over all (robot_at ?r ?wp)) (over all (dock_at ?wp)))
    :effect (and (at start (not (undocked ?r))) (at end (docked ?r))))

  (:durative-action charge
    :parameters (?r - robot)
    :duration (<= ?duration 600)
    :condition (over all (docked ?r))
    :effect (increase (battery ?r) (* #t 0.5)))

  ; a metre costs half a percent; the robot does not set out for where it cannot arrive
  (:durative-action drive
    :parameters (?r - robot ?from ?to - waypoint)
    :duration (= ?duration (/ (distance ?from ?to) (speed ?r)))
    :condition (and
      (at start (robot_at ?r ?from))
      (at start (path ?from ?to))
      (at start (>= (battery ?r) (* 0.5 (distance ?from ?to))))
      (over all (undocked ?r)))
    :effect (and
      (at start (not (robot_at ?r ?from)))
      (at end (robot_at ?r ?to))
      (decrease (battery ?r) (* #t 0.25))))

  (:durative-action pass_door
    :parameters (?r - robot ?d - door ?from ?to - waypoint)
    :duration (= ?duration (/ (distance ?from ?to) (speed ?r)))
    :condition (and
      (at start (robot_at ?r ?from))
      (at start (doorway ?d ?from ?to))
      (at start (>= (battery ?r) (* 0.5 (distance ?from ?to))))
      (over all (open ?d))
      (over all (undocked ?r)))
    :effect (and
      (at start (not (robot_at ?r ?from)))
      (at end (robot_at ?r ?to))
      (decrease (battery ?r) (* #t 0.25))))

  (:action pick_up
    :parameters (?r - robot ?p - parcel ?wp - waypoint)
    :precondition (and (robot_at ?r ?wp) (parcel_at ?p ?wp))
    :effect (and (not (parcel_at ?p ?wp)) (carries ?r ?p)))

  (:action hand_over
    :parameters (?r - robot ?p - parcel ?wp - waypoint)
    :precondition (and (robot_at ?r ?wp) (carries ?r ?p))
    :effect (and (not (carries ?r ?p)) (delivered ?p ?wp))))
