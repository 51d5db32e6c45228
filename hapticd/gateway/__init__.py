"""The gateway process: ZeroMQ on one side, the servo's mailbox on the other.

It renders nothing and may be killed at any time.

    client --ROUTER--> desk --interlocks--> mailbox command ring --> servo
    client <--ROUTER-- desk <---receipt---- mailbox answer ring  <-- servo
    subscribers <--XPUB-- publisher <-- telemetry <-- ring       <-- servo

    server       the one loop
    zmtp         the protocol of ZeroMQ, as one side of a connection
    peers        connections, and what each may cost
    addresses    where the gateway listens; the endpoints file
    auth         who may connect from where
    keys         files of CURVE keys
    outside      the line to the relay, a process that serves listeners with a key (`relay`)
    monitored    what libzmq tells of the connections of a line with keys
    desk         requests in, replies out; the perturbation waveform
    commands     interlocks; requests as commands of the mailbox, answers as receipts
    schemas      what may be asked, as models and as JSON schema
    limits       how much of each parameter may be asked
    codec        msgpack or JSON (the client uses it too)
    view         the servo as seen: its mailbox, its newest record
    telemetry    the ring of records as the messages of each topic
    delivered    how much active damping the board delivers
    publisher    what is due to subscribers; the servo's state in words
    journal      what happened, and who did it
    flight       the flight recorder and its file

`zmtp`, `desk` and `telemetry` do no socket work and read no clock: bytes, messages, records and
times go in, messages come out. `server` owns the only loop, in one thread. What would break it:
a second thread on the mailbox (its rings have one reader and one writer), waiting for the servo
inside a request (answers are collected, never awaited), and a promise that the servo did not make
(receipts and states are the servo's, limits are checked here only to explain them better).
"""
