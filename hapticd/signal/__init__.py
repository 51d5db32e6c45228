"""Arrays in, results out: what is computed from records of force and velocity.

A record goes through `spectra` to `assess`, which gives its verdict. All are pure functions with
frozen results, in numpy alone; where numba is installed (extra [fast]) inner loops are compiled.
Impedance is the force applied to the device over its velocity, N s/m, at the probe unless something
else is said. For scripts:

    assess       `assess`: from spectra to verdict, findings and finer resolution
    spectra      `spa`, `SpectralStream`, `corrected`: Blackman-Tukey spectra of a record
    periodic     `periodic`: spectra of whole periods of a multisine
    impedance    `impedance`: Z with its uncertainty
    findings     `examine`: what is wrong with a record
    resolved     `resolved`, `low_line`: what the window does not resolve, by the record
    verdict      `judge`: passive in a band, not passive, or undecided, with intervals
    alignment    `align`: a record of another system beside the own one
    ledger       `book`: the work that each cause does on the device
    delivered    `estimate`: the active damping that a board really delivers
    passive_set  `passive_set`, `set_limits`, `volume`, `axis_limit`: the set of K, B and M
    envelope     `of_one`, `merged`: the Z-width envelope and its owners
    compare      `widths_db`, `check_alike`, `normalised`: displays side by side
    search       `Search`, `next_trials`, `ModelPrior`: the directed search

The rest serves these: `covariances`, `kernels`, `compiled`, `batch_spectra` and `batch_fft`
(loops over records), `matching` (one signal in another), `channels` (faults of the measuring
channels), `surrogate` (the process behind the search).
"""
