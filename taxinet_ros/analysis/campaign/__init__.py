"""Analysis of a campaign: findings, tables, figures and report."""
