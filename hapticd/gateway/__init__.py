"""The gateway process: ZeroMQ on one side, the servo's mailbox on the other.

It renders nothing and may be killed at any time.

    client --ROUTER--> command server --interlocks, guard--> mailbox command ring --> servo
    client <--ROUTER-- command server <-------receipt------- mailbox answer ring  <-- servo
    subscribers <--XPUB-- publisher <-- telemetry <----- ring           <-- servo

    server            the one loop
    zmtp              the protocol of ZeroMQ, as one side of a connection
    peers             connections, and what each may cost
    addresses         where the gateway listens; the endpoints file
    relay             a process that serves listeners with a key
    relay_supervisor  starts the relay, and hears whom it refused
    command_server    requests in, replies out
    lease_server      what leases mean at the servo
    waveform          the perturbation waveform on its way to the servo
    winding           what the servo follows of the winding's resistance
    tick_times        how long ticks took, by stage, and the late ones by cause
    publisher         what is due to subscribers; the servo's state in words

`zmtp` and `command_server` do no socket work and read no clock: bytes, messages, records and times
go in, messages come out. `server` owns the only loop, in one thread. The rings of the mailbox have
one reader and one writer, so no second thread may use it. A request never waits for the servo; its
answer is collected in a later pass. Receipts and states are the servo's, and limits are checked
here only to explain them better.
"""
