# Options of submit-slurm and parallel; sourced by both. Sets upswing, shards, database, folder, settings
# (options of `upswing db build`), inputs (every file that determines the result), and engine (options for Slurm or
# GNU Parallel).
# shellcheck shell=bash disable=SC2034

read_options() {
    local option grid='' config=''
    upswing='' shards='' database=''
    while getopts :n:g:c:o:u:h option; do
        case $option in
        n) shards=$OPTARG ;;
        g) grid=$OPTARG ;;
        c) config=$OPTARG ;;
        o) database=$OPTARG ;;
        u) upswing=$OPTARG ;;
        h) usage && exit 0 ;;
        *) refuse "unknown option or missing value: -$OPTARG" ;;
        esac
    done
    shift $((OPTIND - 1))
    engine=("$@")

    [[ $shards =~ ^[1-9][0-9]{0,5}$ ]] || refuse "-n: expected a number of shards from 1 to 999999, got '$shards'"
    [[ -n $database ]] || refuse "-o: expected the name of the database to write"
    [[ ! -d $database ]] || refuse "-o: expected a file, $database is a folder"
    upswing=$(type -P "${upswing:-upswing}") || refuse "-u: no program upswing; build it with cargo build --release"
    upswing=$(realpath "$upswing")
    database=$(realpath -m "$database")
    settings=() inputs=("$upswing")
    if [[ -n $config ]]; then
        [[ -d $config ]] || refuse "-c: expected a folder of settings, got $config"
        settings+=(--system "$(realpath "$config")")
        inputs+=("$config"/*.toml "$config"/*.urdf)
    fi
    # A file, or a name that upswing knows.
    if [[ -n $grid ]]; then
        if [[ -e $grid ]]; then
            grid=$(realpath "$grid")
            inputs+=("$grid")
        fi
        settings+=(--grid "$grid")
    fi
    # The name contains the number of shards, so that shards of different partitions are not mixed.
    folder=$database.shards-$shards
    mkdir -p "$folder/log"
}

refuse() {
    echo "error: $*" >&2
    usage >&2
    exit 2
}
