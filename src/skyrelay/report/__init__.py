"""The run report: figures and a page that replays the run. It reads run folders only."""

from skyrelay.report.figures import write_figures
from skyrelay.report.page import write_report

__all__ = ["write_figures", "write_report"]
