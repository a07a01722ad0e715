"""Messages on the wire and in a bag: topics, types, and the codecs of their bytes."""
