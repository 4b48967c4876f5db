"""What light and air on the facets of a surface cost, and the light curve of a tumbling body."""
