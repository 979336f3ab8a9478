; The morning round: two parcels to the laboratory, whose door is open from two minutes after loading until twelve.
(define (problem morning-round)
  (:domain deliveries)
  (:objects
    kenny - robot
    home office corridor lab - waypoint
    lab_door - door
    blood linen - parcel)
  (:init
    (robot_at kenny home)
    (docked kenny)
    (dock_at home)
    (= (battery kenny) 62)
    (= (speed kenny) 0.5)

    (path home office)     (path office home)     (= (distance home office) 12)     (= (distance office home) 12)
    (path office corridor) (path corridor office) (= (distance office corridor) 30) (= (distance corridor office) 30)
    (path home corridor)   (path corridor home)   (= (distance home corridor) 24)   (= (distance corridor home) 24)
    (doorway lab_door corridor lab) (doorway lab_door lab corridor)
    (= (distance corridor lab) 20)  (= (distance lab corridor) 20)

    (parcel_at blood office)
    (parcel_at linen office)

    (at 120 (open lab_door))
    (at 720 (not (open lab_door))))
  (:goal (and (delivered blood lab) (delivered linen lab) (docked kenny)))
  (:metric minimize (total-time)))
