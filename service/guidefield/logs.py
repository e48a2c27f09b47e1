"""How a process of the service logs: lines for a person, or one JSON object a line for a machine."""

from __future__ import annotations

import json as json_text
import logging

PLAIN = "%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s"


class JsonLines(logging.Formatter):
    """One JSON object a line: time [s since 1970], level, process, logger, message, and the trace of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        line = {
            "time": record.created,
            "level": record.levelname,
            "process": record.process,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json_text.dumps(line, ensure_ascii=False)


def configure(level: int, *, json: bool) -> None:
    """Log to stderr what is at least of a level."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines() if json else logging.Formatter(PLAIN))
    logging.basicConfig(level=level, handlers=[handler])
