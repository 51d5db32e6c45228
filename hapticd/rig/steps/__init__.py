"""The steps of commissioning: each measures one thing and concludes with a `StepResult`."""
