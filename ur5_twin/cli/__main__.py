from ur5_twin.cli import main

main()
