# In the guest, within the host's file system: networks up, then the command.
PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
job=/run/dbw-job
ip link set lo up
for name in vcan0 vcan1; do ip link add "$name" type vcan && ip link set "$name" up; done
# The kernel may report the second link as down for another second, but carries its frames.
for name in can0 can1; do
    ip link set "$name" up txqueuelen 1000 type can bitrate 500000 restart-ms 100
done
ln -s /proc/self/fd /dev/fd
for number in 0:stdin 1:stdout 2:stderr; do
    ln -s "/proc/self/fd/${number%:*}" "/dev/${number#*:}"
done
if [ -e $job/interactive ]; then
    echo booted > $job/state
    setsid -c sh $job/command.sh < /dev/ttyS0 > /dev/ttyS0 2>&1
    echo $? > $job/exit
    exit
fi

# A serial port takes 32 KiB at once and is opened once; the command gets what it knows: pipes.
mkfifo /run/stdout /run/stderr
pumps=:
for port in /sys/class/virtio-ports/*; do
    read -r name < "$port/name"
    LC_ALL=C dd bs=64k < "/run/$name" > "/dev/${port##*/}" 2> "$job/copied.$name" &
    pumps=$pumps$!:
done
echo booted > $job/state
sh $job/command.sh < /dev/null > /run/stdout 2> /run/stderr
code=$?
for process in /proc/[0-9]*; do  # whom the command left behind would keep the pipes open
    id=${process#/proc/}
    case :1:$$$pumps in *":$id:"*) ;; *) kill -KILL "$id" ;; esac
done 2> /dev/null
wait
sync
echo $code > $job/exit
while sleep 1; do :; done  # the host ends the machine when it has all that was copied
