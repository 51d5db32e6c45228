"""The batch engine: thousands of trials of one scene, vectorised across trials, with the servo's
own tick law.

    simulate(scene, params, ...)   n trials that differ in stiffness, damping and mass
    BatchResult                    its result: sums, spectra or records of each trial

    model --shape--> fewer coefficients, compiled features --source--> text --kernels--> machine
    code; K, B, M --job--> rows of the state array --kernel, block by block--> tallies --records-->
    spectra or records --batch--> BatchResult

Every step is exact for held inputs (matrix exponential), so a linear scene has no step error at
all; friction, ends and cogging are solved once per sub-step. The law is compiled from `render`, not
written again; `parts` may be added to it. An effect that the scene does not have costs nothing.
Results do not depend on how trials are spread over lanes, tasks, threads or machines of one kind.

The fastmath of `source` must not reassociate and must preserve NaN. Arrays must begin on a cache
line (otherwise half the speed), and the law must be compiled with an explicit fastmath=False
(`compiled`). numba is imported only when a kernel is needed.
"""
