"""Analysis of records of force and velocity: arrays in, results out.

`spectra` turns a record into spectra, and `assess` turns spectra into a verdict. All functions are
pure, their results are frozen, and they need numpy alone. If numba is installed (extra [fast]),
inner loops are compiled. Impedance is the force applied to the device over its velocity, N s/m,
measured at the probe unless stated otherwise. For scripts:

    assess       `assess`: from spectra to verdict, findings and finer resolution; `periodic`:
                 spectra of whole periods of a multisine
    spectra      `spa`, `SpectralStream`, `corrected`: Blackman-Tukey spectra of a record
    impedance    `impedance`: Z with its uncertainty
    findings     `examine`: defects and anomalies of a record
    resolved     `resolved`, `low_line`: lines narrower than the window, from the whole record
    verdict      `judge`: passive in a band, not passive, or undecided, with intervals

The other modules serve these: `covariances`, `compiled`, `batch_spectra` and `batch_fft`
(loops over records), and `channels` (faults of the measuring channels).
"""
