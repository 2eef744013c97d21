"""Why a campaign or a run failed: the stages, the verdict and its page."""
