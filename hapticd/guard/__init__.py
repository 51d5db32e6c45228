"""Check whether a change is passive, and apply it in an order that stays passive.

The gateway passes a request to this package, and a worker process judges it. The stages that the
policy allows go into the mailbox one after the other. Imports point from gateway to guard to
mailbox.

The criterion consists of pure functions of a device model and of environments:

    bases               Theorem, Predicted, Measured: the grounds on which an environment is safe
    safe_region         SafeRegion: the safe environments, and the allowed ranges of K, B and M;
                        the passive range of each alone, and the stiffness lost to the delay
    transition_planner  the stages of a change and the points on its path; interpolation between
                        two environments
    policies            the answer to a change, according to the policy
    plane               the K-B plane with and without active damping
    judge               Judge: answers the requests of the gateway
    explain             verdict, reasons and remedies as plain maps

A request passes through these modules:

    status              the policy in force, and the last results of the worker
    request_queue       the queue of requests that wait for a verdict
    pending             one such request, and its stages as received from the worker
    refusals            refusals and verdicts without the judgement of the worker
    scheduled           changes that the servo holds for later ticks
    outstanding         posted commands that are not yet answered
    stages              the multi-stage change in progress
    in_force            the environment in force, from the newest record and the last answer
    terms               policy, basis, margin and mode, kept across a restart of the gateway
    delay               the loop delay of the last minute
    delivered           the active damping that the board delivers
    worker              the connection to the worker process; main: that process
"""
