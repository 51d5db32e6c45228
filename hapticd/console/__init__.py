"""The operators' page: one process that is an ordinary client of a daemon, and a web server for
browsers on this computer.

    server   the web server: pages, the socket of each browser, the STOP request
    browser  one open page: what waits for it is bounded, the oldest is dropped
    asker    the commands of one browser: a client of its own, so that leases are the browser's
    visitors who may talk to it
    watch    telemetry -> frames for browsers, in a thread of its own
    probing  live impedance from the probe stream: a running estimate
    plane    the K-B plane of the guard, computed by a process of its own
    recorder `hapticd record` as a process of its own, which ends with this one
    static/  the page itself; beside our own files one that is not ours, uPlot

Nothing here renders, judges or promises force: what the page shows is what the daemon says, and
what it asks goes the way of every client's request, the stop that of `hapticd stop`. Whatever
becomes of this process or of a browser, the servo goes on as it is.
"""
