"""What a fit may say: what is determined and why not, what the model leaves out, and all of it in sentences,
as a `Fit`."""
