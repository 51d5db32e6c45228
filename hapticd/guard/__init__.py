"""Check whether a change is passive, and apply it in an order that stays passive.

The gateway passes a request to this package, and a worker process judges it. The stages that the
policy allows go into the mailbox one after the other. Imports point from gateway to guard to
mailbox.

The criterion consists of pure functions of a basis (`model.bases`) and of environments:

    safe_region         SafeRegion: the safe environments, and the allowed ranges of K, B and M; the
                        passive range of each alone, and the stiffness lost to the delay; verdict,
                        reasons and remedies as plain maps
    transition_planner  the stages of a change and the points on its path; interpolation between
                        two environments
    policies            the answer to a change, according to the policy
    judge               Judge: answers the requests of the gateway; the K-B plane with and without
                        active damping

A request passes through these modules:

    status              the policy in force, and the last results of the worker
    request_queue       the queue of requests that wait for a verdict
    pending             one such request, its stages as received from the worker, its refusals and
                        verdicts without the worker's judgement; changes that the servo holds for
                        later ticks; posted commands that are not yet answered
    stages              the multi-stage change in progress
    terms               policy, basis, margin and mode, kept across a restart of the gateway; the
                        environment in force, from the newest record and the last answer; the loop
                        delay of the last minute
    delivered           the active damping that the board delivers
    delivered_estimate  its estimate from sums of products, with an interval
    worker              the worker process, and the connection to it
"""
