"""Commands on bags: taxinet bag ..., and taxinet doctor."""
