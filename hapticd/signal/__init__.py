"""Arrays in, results out: what is computed from records of force and velocity, and from models.

A record goes through `spectra` to `impedance` and `verdict`; a model through `loop` to `predict`
and `theorem`. All are pure functions with frozen results, in numpy alone; where numba is installed
(extra [fast]) inner loops are compiled. Impedance is the force applied to the device over its
velocity, N s/m, at the probe unless something else is said. For scripts:

    spectra      `spa`, `SpectralStream`, `corrected`: Blackman-Tukey spectra of a record
    periodic     `periodic`: spectra of whole periods of a multisine
    impedance    `impedance`: Z with its uncertainty
    findings     `examine`: what is wrong with a record
    resolved     `resolved`: Z where the motion is narrower than the window
    verdict      `judge`: passive in a band, not passive, or undecided, with intervals
    predict      `predict`, `predicted_impedance`: passive or not without a trial
    alignment    `align`: a record of another system beside the own one
    ledger       `book`: the work that each cause does on the device
    delivered    `estimate`: the active damping that a board really delivers
    theorem      `required_damping`, `lift`, `lifted_margin`: Colgate and Schenkel
    angles       where a device is looked at, dense about its modes
    rational     `rational`, `positive_everywhere`: the theorem at all angles, without a grid
    coupled      `withstands`, `shaking_hand`: what a passive hand can do
    outlook      `outlook`: all of these about one environment
    bases        `Theorem`, `Predicted`, `Measured`: how it is known what is safe
    allowed      `Judgement`: which displays a device withstands, and how far K, B and M may go
    judge        `Judge`: the answers of the guard; what it does with a change by `policies`
    plane        `plane`: the K-B plane, with and without active damping
    passive_set  `passive_set`, `set_limits`, `volume`, `axis_limit`: the set of K, B and M
    envelope     `envelope`: the Z-width envelope and its owners
    compare      `widths_db`, `check_alike`, `normalised`: displays side by side
    search       `Search`, `next_trials`: the directed search; `prior`: what a model knows before it

The rest serves these: `covariances`, `kernels`, `compiled`, `batch_spectra` and `batch_fft`
(loops over records), `matching` and `gaps` (one signal in another), `channels` (faults of the
measuring channels), `low_lines` (limit cycles below the lines of a window), `loop`, `linearise`
and `narrow` (the model's loop), `displays`, `ways` and `words` (of a change), `surrogate` (the
process behind the search), `arrays` (types).
"""
