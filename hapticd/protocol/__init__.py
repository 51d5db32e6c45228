"""What the daemon and its clients say to each other: no socket, no clock.

schemas      what a client may ask, one strict model for each command
answers      what is answered, as frozen dataclasses: the one schema of replies
codec        msgpack or JSON, within hard limits; a request with its sender
commands     interlocks; requests as commands of the mailbox, answers as receipts
limits       how much of each parameter may be asked
leases       who may change what
explanation  outcome, reasons and remedies of the guard, as typed entries
telemetry    tick records as the messages of each topic
view         the servo by its mailbox and its newest record
ledger       tick records as the energy ledger of the topic
journal      what happened, and who did it
flight       the flight recorder and its file
auth, keys   who may connect from where; files of CURVE keys
zmq_monitor  what libzmq reports of the connections of a socket
"""
