"""Files, drawings and pages that a run, a comparison or a noise model is shown by."""
