"""The mechanical model, which does not depend on the integration methods."""
