"""The operators' page: one process that is an ordinary client of a daemon, and a web server for
browsers on this computer.

    server   the web server: pages, the socket of each browser, the STOP request; `hapticd record`
             as a separate process, which ends with this one
    browser  one open page: its queue is bounded, the oldest message is dropped; the commands of one
             browser, sent by its own client, which holds its leases; access control: who may use
             the page
    watch    telemetry -> frames for browsers, in its own thread; live impedance from the probe
             stream: a running estimate
    plane    the K-B plane of the guard, computed in a separate process
    static/  the page itself; one file is third-party: uPlot

No module here renders or judges. The page shows the daemon's actual state, and its requests are
ordinary client requests; its stop is that of `hapticd stop`. The servo continues unchanged if this
process or a browser dies.
"""
