"""Whether a change is passive, and in which order it is applied.

The gateway hands a request over, a worker process judges it, and the stages that the policy allows
go into the mailbox one after the other. The direction is gateway -> guard -> mailbox.

The criterion, as pure functions of a device's model and of environments:

    bases               Theorem, Predicted, Measured: how it is known what is safe
    safe_region         SafeRegion: which environments are safe, and how far K, B and M may go;
                        what a device renders of each alone, and what its delay costs
    transition_planner  the stages of a change and the points that it passes; what lies between two
                        environments
    policies            what is done with a change, by the policy in force
    plane               the K-B plane with and without active damping
    judge               Judge: requests of the gateway in, answers out
    explain             verdict, reasons and remedies as they are sent

The life of a request:

    status              the policy in force, and what the worker last said
    request_queue       requests on their way past the guard
    pending             one of them, and its stages as the worker names them
    refusals            what is said where the worker has not judged
    scheduled           changes that the servo holds for later ticks
    outstanding         commands that were posted, until they are answered
    stages              the change of several stages that is under way
    in_force            the environment in force, by record and answer
    terms               what the guard goes by, and what is left of it when the gateway starts anew
    delay               the delay that the loop had in the last minute
    delivered           how much active damping the board delivers
    worker              the line to the worker process; main: that process
"""
