# Options of submit-slurm and parallel; sourced by both. Sets upswing, shards, output, folder, work (the command whose
# shards are computed, with its options), inputs (every file that determines the result), and engine (options for Slurm or
# GNU Parallel).
# shellcheck shell=bash disable=SC2034

read_options() {
    local option grid='' config='' study=''
    upswing='' shards='' output=''
    while getopts :n:g:m:c:o:u:h option; do
        case $option in
        n) shards=$OPTARG ;;
        g) grid=$OPTARG ;;
        m) study=$OPTARG ;;
        c) config=$OPTARG ;;
        o) output=$OPTARG ;;
        u) upswing=$OPTARG ;;
        h) usage && exit 0 ;;
        *) refuse "unknown option or missing value: -$OPTARG" ;;
        esac
    done
    shift $((OPTIND - 1))
    engine=("$@")

    [[ $shards =~ ^[1-9][0-9]{0,5}$ ]] || refuse "-n: expected a number of shards from 1 to 999999, got '$shards'"
    [[ -n $output ]] || refuse "-o: expected the name of the file to write"
    [[ ! -d $output ]] || refuse "-o: expected a file, $output is a folder"
    [[ -z $study || -z $grid ]] || refuse "-m: a study has no grid; name its database by its options"
    upswing=$(type -P "${upswing:-upswing}") || refuse "-u: no program upswing; build it with cargo build --release"
    upswing=$(realpath "$upswing")
    output=$(realpath -m "$output")
    work=(db build) inputs=("$upswing")
    if [[ -n $study ]]; then
        # The words of the study and its options.
        read -r -a work <<<"$study"
        work=(montecarlo "${work[@]}")
    fi
    if [[ -n $config ]]; then
        [[ -d $config ]] || refuse "-c: expected a folder of settings, got $config"
        work+=(--system "$(realpath "$config")")
        inputs+=("$config"/*.toml "$config"/*.urdf)
        [[ -z $study ]] || inputs+=("$config"/*.bin)
    fi
    # A file, or a name that upswing knows.
    if [[ -n $grid ]]; then
        if [[ -e $grid ]]; then
            grid=$(realpath "$grid")
            inputs+=("$grid")
        fi
        work+=(--grid "$grid")
    fi
    # The name contains the number of shards, so that shards of different partitions are not mixed.
    folder=$output.shards-$shards
    mkdir -p "$folder/log"
}

refuse() {
    echo "error: $*" >&2
    usage >&2
    exit 2
}
