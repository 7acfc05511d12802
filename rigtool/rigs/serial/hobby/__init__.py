"""Controllers of hobby motors that take currents: the host closes the loop around them."""
