"""How wrong a reduced model is: responses, residuals, certificates."""
