"""The gateway process: ZeroMQ on one side, the servo's mailbox on the other.

It renders nothing and may be killed at any time.

    client --ROUTER--> desk --interlocks--> mailbox command ring --> servo
    client <--ROUTER-- desk <---receipt---- mailbox answer ring  <-- servo
    subscribers <--XPUB-- topics <-- feed <-- telemetry ring     <-- servo

`desk` and `feed` do no socket work and read no clock: messages, records and times go in, messages
come out. `server` owns the sockets and the only loop, in one thread. What would break it: a second
thread on the mailbox (its rings have one reader and one writer), waiting for the servo inside a
request (answers are collected, never awaited), and a promise that the servo did not make (receipts
and states are the servo's, limits are checked here only to explain them better).
"""
