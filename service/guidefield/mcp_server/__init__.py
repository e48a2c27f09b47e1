"""A server of the Model Context Protocol: a language model asks for plans, a service answers, in words and figures."""
