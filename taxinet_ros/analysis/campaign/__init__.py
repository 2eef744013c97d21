"""What a campaign says: findings, tables, figures and its report."""
