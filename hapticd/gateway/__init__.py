"""The gateway process: ZeroMQ on one side, the servo's mailbox on the other.

It renders no force and may be killed at any time.

    client --ROUTER--> command server --interlocks, guard--> mailbox command ring --> servo
    client <--ROUTER-- command server <-------receipt------- mailbox answer ring  <-- servo
    subscribers <--XPUB-- publisher <-- telemetry <----- ring           <-- servo

    server            the event loop; the sockets; the endpoints file
    peers             connections, and the bounds on each; the protocol of ZeroMQ, one side of a
                      connection
    relay             a separate process for subscribers with a key; its start, and refused clients
    command_server    requests in, replies out
    lease_server      the effects of leases at the servo; the transfer of the perturbation waveform
                      to the servo
    tick_times        durations of ticks by stage, and late ticks by cause; the compensation of the
                      winding's resistance
    publisher         messages to subscribers; the topic `state`; events of states, faults and
                      the proxy

`command_server` does no socket work and reads no clock: bytes, messages, records and times
go in, messages come out. `server` runs the only loop, in one thread. The rings of the mailbox have
one reader and one writer, so no second thread may use them. A request never waits for the servo; a
later pass collects its answer. Receipts and states come from the servo. Limits are checked here
only to give a better explanation.
"""
