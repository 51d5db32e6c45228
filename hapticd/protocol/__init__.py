"""The messages between the daemon and its clients: no socket, no clock.

schemas      requests, one strict model for each command
answers      replies, as frozen dataclasses: the one schema of replies
codec        msgpack or JSON, within hard limits; a request with its sender
commands     interlocks; requests as commands of the mailbox, answers as receipts
limits       the range of each parameter of a command; the limits of K, B and M of a device
leases       the exclusive rights of clients; access by address
journal      events and the actors behind them; outcome, reasons and remedies of the guard, as typed
             entries
telemetry    tick records as the messages of each topic
view         the servo as seen by its mailbox and its newest record
ledger       the work that each cause does on the device, from tick records
flight       the flight recorder and its file
keys         files of CURVE keys; libzmq's events about the connections of a socket
"""
