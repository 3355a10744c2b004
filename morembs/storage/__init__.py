"""Files of morembs: bodies, models, series for ParaView. Written whole or not at all."""
